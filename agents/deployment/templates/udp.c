/* {{ name }} as a process of its own: measurements in, commands out, by UDP on the loopback.
 *
 *   {{ name }}_udp            prints the port that it listens on, and serves until it is told to end
 *
 * The datagram, little-endian (the machine must be, too):
 *   0 "{{ magic }}", 4 kind ({{ measurement }} measurement, {{ command }} command), 5 version {{ version }},
 *   6 flags ({{ begins }} a test begins, {{ refused }} refused, {{ ends }} the end; of a command, the upper byte counts the
 *   measurements of the test that were not answered), 8 sequence number, 12 time [s], 20 number n of
 *   channels, 22 number of the test, {{ header }} channels in SI, {{ header }} + 8 n CRC-32.
 */
#define _POSIX_C_SOURCE 200112L
#include "{{ name }}.h"

#include <arpa/inet.h>
#include <errno.h>
#include <netinet/in.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <unistd.h>

#define HEADER {{ header }}
#define IN_SIZE (HEADER + 8 * {{ NAME }}_INPUTS + 4)
#define OUT_SIZE (HEADER + 8 * {{ NAME }}_OUTPUTS + 4)
#define PATIENCE 60 /* [s] without a datagram, after which the program ends */

static {{ name }}_t memory;
static uint32_t crc_table[256];
static uint32_t ignored; /* datagrams of this test that were not answered */

static void make_crc_table(void)
{
    for (uint32_t i = 0; i < 256U; i++) {
        uint32_t c = i;

        for (int bit = 0; bit < 8; bit++) {
            c = ((c & 1U) != 0U) ? 0xEDB88320U ^ (c >> 1) : c >> 1;
        }
        crc_table[i] = c;
    }
}

static uint32_t crc32(const unsigned char *data, size_t size)
{
    uint32_t c = 0xFFFFFFFFU;

    for (size_t i = 0; i < size; i++) {
        c = crc_table[(c ^ data[i]) & 0xFFU] ^ (c >> 8);
    }
    return c ^ 0xFFFFFFFFU;
}

/* Whether these bytes are a measurement for this controller. */
static int is_measurement(const unsigned char *data, ssize_t size)
{
    uint16_t count;
    uint32_t check;

    if (size != (ssize_t)IN_SIZE || memcmp(data, "{{ magic }}", 4) != 0 || data[4] != {{ measurement }} || data[5] != {{ version }}) {
        return 0;
    }
    memcpy(&count, &data[20], 2);
    memcpy(&check, &data[IN_SIZE - 4], 4);
    return count == {{ NAME }}_INPUTS && check == crc32(data, IN_SIZE - 4);
}

/* Decide, and write the command into out. */
static void answer(const unsigned char *in, unsigned char *out)
{
    {{ name }}_real inputs[{{ NAME }}_INPUTS], outputs[{{ NAME }}_OUTPUTS];
    const uint16_t count = {{ NAME }}_OUTPUTS;
    uint16_t flags = (uint16_t)((ignored & 0xFFU) << 8);
    uint32_t check;

    for (int i = 0; i < {{ NAME }}_INPUTS; i++) {
        double value;

        memcpy(&value, &in[HEADER + 8 * i], 8);
        inputs[i] = ({{ name }}_real)value;
    }
    if ({{ name }}_step_si(&memory, inputs, outputs) != {{ NAME }}_OK) {
        flags = (uint16_t)(flags | {{ refused }}U);
    }
    memcpy(out, in, HEADER);
    out[4] = {{ command }};
    memcpy(&out[6], &flags, 2);
    memcpy(&out[20], &count, 2);
    for (int i = 0; i < {{ NAME }}_OUTPUTS; i++) {
        const double value = (double)outputs[i];

        memcpy(&out[HEADER + 8 * i], &value, 8);
    }
    check = crc32(out, OUT_SIZE - 4);
    memcpy(&out[OUT_SIZE - 4], &check, 4);
}

int main(void)
{
    const struct timeval patience = {PATIENCE, 0};
    struct sockaddr_in own, other;
    socklen_t length = sizeof own;
    unsigned char in[IN_SIZE + 1], out[OUT_SIZE];
    uint32_t last = 0;
    uint16_t test = 0;
    int running = 0;
    const int s = socket(AF_INET, SOCK_DGRAM, 0);

    memset(&own, 0, sizeof own);
    own.sin_family = AF_INET;
    own.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    if (s < 0 || bind(s, (struct sockaddr *)&own, sizeof own) != 0
        || getsockname(s, (struct sockaddr *)&own, &length) != 0
        || setsockopt(s, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience) != 0) {
        perror("socket");
        return 1;
    }
    (void)mlockall(MCL_CURRENT | MCL_FUTURE); /* where it is permitted: no page is fetched in a test */
    make_crc_table();
    {{ name }}_init(&memory);
    printf("%d\n", (int)ntohs(own.sin_port));
    fflush(stdout);
    for (;;) {
        socklen_t size = sizeof other;
        const ssize_t got = recvfrom(s, in, sizeof in, 0, (struct sockaddr *)&other, &size);
        uint16_t flags, number;
        uint32_t sequence;

        if ((got < 0) && (errno == EINTR)) {
            continue; /* a signal, such as the one that lets a stopped program go on */
        }
        if (got < 0) {
            break;
        }
        if (is_measurement(in, got) == 0) {
            ignored++;
            continue;
        }
        memcpy(&flags, &in[6], 2);
        memcpy(&sequence, &in[8], 4);
        memcpy(&number, &in[22], 2);
        if ((flags & {{ ends }}U) != 0U) {
            break;
        }
        if ((flags & {{ begins }}U) != 0U && (running == 0 || number != test)) {
            {{ name }}_reset(&memory);
            test = number;
            ignored = 0;
        } else if (running == 0 || number != test || sequence <= last) {
            ignored++;
            continue; /* repeated or out of order: one decision a period, from the newest measurement */
        } else {
            /* the next period of the test */
        }
        running = 1;
        last = sequence;
        answer(in, out);
        (void)sendto(s, out, OUT_SIZE, 0, (const struct sockaddr *)&other, size);
    }
    close(s);
    return 0;
}
