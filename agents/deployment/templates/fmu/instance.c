{# What both versions of FMI have in common: an instance and one communication step. #}
#include "{{ name }}.h"

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

#define FIRST 1U /* value reference of the first input; 0 is the time */
#define OK 0
#define ERROR 3
#define VARIABLES ({{ NAME }}_INPUTS + {{ NAME }}_OUTPUTS)

/* Value references: inputs, then outputs, in the order of {{ name }}.h, from FIRST on; SI. */
typedef struct {
    {{ name }}_t memory;
    double values[VARIABLES];
    double time; /* [s] */
} instance_t;

static void begin(instance_t *instance)
{
    {{ name }}_init(&instance->memory);
    for (int i = 0; i < VARIABLES; i++) {
        instance->values[i] = 0.0;
    }
}

static instance_t *instantiate(const char *token)
{
    instance_t *made = NULL;

    if (token != NULL && strcmp(token, "{{ token }}") == 0) {
        made = (instance_t *)calloc(1, sizeof *made);
        if (made != NULL) {
            begin(made);
        }
    }
    return made;
}

/* Communication steps are whole periods; inputs are held. */
static int do_step(instance_t *instance, double point, double size)
{
    const double periods = floor(size / {{ NAME }}_PERIOD + 0.5);
    {{ name }}_real inputs[{{ NAME }}_INPUTS], outputs[{{ NAME }}_OUTPUTS];
    int status = OK;

    if (!(periods >= 1.0) || fabs(size - periods * {{ NAME }}_PERIOD) > 1e-6 * {{ NAME }}_PERIOD) {
        return ERROR;
    }
    for (int i = 0; i < {{ NAME }}_INPUTS; i++) {
        inputs[i] = ({{ name }}_real)instance->values[i];
    }
    for (long k = 0; k < (long)periods && status == OK; k++) {
        if ({{ name }}_step_si(&instance->memory, inputs, outputs) != {{ NAME }}_OK) {
            status = ERROR;
        }
        for (int i = 0; i < {{ NAME }}_OUTPUTS; i++) {
            instance->values[{{ NAME }}_INPUTS + i] = (double)outputs[i];
        }
    }
    instance->time = point + size;
    return status;
}

/* Outputs may be set while initialising only; nothing reads what was set. */
static int set_values(instance_t *instance, const unsigned int *references, size_t count, const double *values)
{
    for (size_t i = 0; i < count; i++) {
        if (references[i] < FIRST || references[i] - FIRST >= VARIABLES) {
            return ERROR;
        }
        instance->values[references[i] - FIRST] = values[i];
    }
    return OK;
}

static int get_values(const instance_t *instance, const unsigned int *references, size_t count, double *values)
{
    for (size_t i = 0; i < count; i++) {
        if (references[i] < FIRST) {
            values[i] = instance->time;
        } else if (references[i] - FIRST < VARIABLES) {
            values[i] = instance->values[references[i] - FIRST];
        } else {
            return ERROR;
        }
    }
    return OK;
}

static int get_state(const instance_t *instance, void **state)
{
    if (*state == NULL) {
        *state = malloc(sizeof *instance);
    }
    if (*state == NULL) {
        return ERROR;
    }
    memcpy(*state, instance, sizeof *instance);
    return OK;
}

static int set_state(instance_t *instance, const void *state)
{
    memcpy(instance, state, sizeof *instance);
    return OK;
}

static int free_state(void **state)
{
    free(*state);
    *state = NULL;
    return OK;
}

static int serialize(const void *state, void *bytes, size_t size)
{
    if (size != sizeof(instance_t)) {
        return ERROR;
    }
    memcpy(bytes, state, size);
    return OK;
}

static int deserialize(const void *bytes, size_t size, void **state)
{
    if (size != sizeof(instance_t)) {
        return ERROR;
    }
    if (*state == NULL) {
        *state = malloc(size);
    }
    if (*state == NULL) {
        return ERROR;
    }
    memcpy(*state, bytes, size);
    return OK;
}
