/* Tests of {{ name }}: recorded decisions; with --stream those of standard input; with --time its speed.
 *
 * --stream reads doubles, {{ NAME }}_INPUTS + 1 a period: first 1 where a test begins and else 0, then
 * the inputs over their scales. It writes {{ NAME }}_OUTPUTS + 1 doubles a period: code, then outputs.
 * --time N times N steps, at most and by default TIMED.
 */
#define _POSIX_C_SOURCE 199309L
#include "{{ name }}.h"
#include "{{ name }}_recorded.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define TOLERANCE {{ tolerance }} /* of the outputs' range */
#define TIMED 100000

static {{ name }}_t memory;
static double times[TIMED];
static int steps = TIMED;

static int check(void)
{
    {{ name }}_real outputs[{{ NAME }}_OUTPUTS];
    double worst = 0.0;

    {{ name }}_init(&memory);
    for (int k = 0; k < RECORDED; k++) {
        {{ name }}_real inputs[{{ NAME }}_INPUTS];

        for (int i = 0; i < {{ NAME }}_INPUTS; i++) {
            inputs[i] = ({{ name }}_real)recorded_inputs[k][i];
        }
        if ({{ name }}_step(&memory, inputs, outputs) != {{ NAME }}_OK) {
            printf("decision %d: refused\n", k);
            return 1;
        }
        for (int i = 0; i < {{ NAME }}_OUTPUTS; i++) {
            const double size = fabs(recorded_outputs[k][i]) > 1.0 ? fabs(recorded_outputs[k][i]) : 1.0;
            const double error = fabs((double)outputs[i] - recorded_outputs[k][i]) / size;

            worst = error > worst ? error : worst;
        }
    }
    printf("%s: %d periods, largest difference %.3g\n", worst <= TOLERANCE ? "ok" : "WRONG", RECORDED, worst);
    return worst <= TOLERANCE ? 0 : 1;
}

static int stream(void)
{
    double row[{{ NAME }}_INPUTS + 1];

    {{ name }}_init(&memory);
    while (fread(row, sizeof row, 1, stdin) == 1) {
        {{ name }}_real inputs[{{ NAME }}_INPUTS], outputs[{{ NAME }}_OUTPUTS];
        double answer[{{ NAME }}_OUTPUTS + 1];

        for (int i = 0; i < {{ NAME }}_INPUTS; i++) {
            inputs[i] = ({{ name }}_real)row[i + 1];
        }
        if (row[0] > 0.5) {
            {{ name }}_reset(&memory);
        }
        answer[0] = (double){{ name }}_step(&memory, inputs, outputs);
        for (int i = 0; i < {{ NAME }}_OUTPUTS; i++) {
            answer[i + 1] = (double)outputs[i];
        }
        if (fwrite(answer, sizeof answer, 1, stdout) != 1) {
            return 1;
        }
    }
    return 0;
}

static int ascending(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;

    return (x > y) - (x < y);
}

/* Times of steps by a clock, in ascending order; return the sum of the first outputs. */
static double measure(clockid_t clock)
{
    {{ name }}_real outputs[{{ NAME }}_OUTPUTS];
    double sum = 0.0;

    {{ name }}_init(&memory);
    for (int k = 0; k < steps; k++) {
        {{ name }}_real inputs[{{ NAME }}_INPUTS];
        struct timespec before, after;

        for (int i = 0; i < {{ NAME }}_INPUTS; i++) {
            inputs[i] = ({{ name }}_real)recorded_inputs[k % RECORDED][i];
        }
        clock_gettime(clock, &before);
        {{ name }}_step(&memory, inputs, outputs);
        clock_gettime(clock, &after);
        sum += (double)outputs[0];
        times[k] = 1e6 * (double)(after.tv_sec - before.tv_sec) + 1e-3 * (double)(after.tv_nsec - before.tv_nsec);
    }
    qsort(times, (size_t)steps, sizeof times[0], ascending);
    return sum;
}

/* By the clock on the wall, and by the processor's time of this thread, which leaves out when others ran. */
static int report(void)
{
    const double sum = measure(CLOCK_MONOTONIC);
    const double median = times[steps / 2], worst = times[steps - 1];

    (void)measure(CLOCK_THREAD_CPUTIME_ID);
    printf("{\"steps\": %d, \"median_us\": %.3f, \"worst_us\": %.3f, \"worst_processor_us\": %.3f, \"sum\": %.9g}\n",
        steps, median, worst, times[steps - 1], sum);
    return 0;
}

int main(int argc, char **argv)
{
    if (argc > 1 && strcmp(argv[1], "--stream") == 0) {
        return stream();
    }
    if (argc > 1 && strcmp(argv[1], "--time") == 0) {
        if (argc > 2) {
            steps = atoi(argv[2]);
        }
        if (steps < 1 || steps > TIMED) {
            printf("%d steps: give 1 to %d\n", steps, TIMED);
            return 2;
        }
        return report();
    }
    return check();
}
