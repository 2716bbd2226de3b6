/* The other end of a pseudo-terminal, and what a request costs without an event loop.
 *
 *   peer answer        opens a pseudo-terminal, prints its name, acks every request until its
 *                      input ends
 *   peer ask PATH      per line of input a number: sends as many requests, each when the ack of
 *                      the one before is there; prints CPU time and median per request, in s
 *
 * Checksums of what arrives are not looked at.
 */
#define _GNU_SOURCE
#include <fcntl.h>
#include <poll.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

enum { HEADER = 12, OVERHEAD = 16, MOST = 1023, DATA = 9 };

static uint16_t crc16_of[256];
static uint32_t crc32_of[256];

static void make_tables(void) {
    for (unsigned n = 0; n < 256; n++) {
        unsigned low = n, high = n;
        for (int bit = 0; bit < 8; bit++) {
            low = low & 1 ? low >> 1 ^ 0xA001 : low >> 1;
            high = high & 1 ? high >> 1 ^ 0xEDB88320u : high >> 1;
        }
        crc16_of[n] = low;
        crc32_of[n] = high;
    }
}

static int encode(uint8_t *frame, const uint8_t *data, int size, int session, int is_ack, int number) {
    int length = size + OVERHEAD;
    uint8_t header[10] = {0xAA, length & 0xFF, length >> 8, session | is_ack << 5};
    uint16_t low = 0x3AA3;
    uint32_t high = 0x3AA3;
    header[8] = number & 0xFF;
    header[9] = number >> 8;
    memcpy(frame, header, sizeof header);
    for (int at = 0; at < 10; at++) low = low >> 8 ^ crc16_of[(low ^ frame[at]) & 0xFF];
    frame[10] = low & 0xFF;
    frame[11] = low >> 8;
    memcpy(frame + HEADER, data, size);
    for (int at = 0; at < HEADER + size; at++) high = high >> 8 ^ crc32_of[(high ^ frame[at]) & 0xFF];
    for (int byte = 0; byte < 4; byte++) frame[HEADER + size + byte] = high >> 8 * byte;
    return length;
}

/* Bytes of the first whole frame; 0 while there is none. */
static int whole(const uint8_t *bytes, int size) {
    if (size < HEADER) return 0;
    int length = bytes[1] | (bytes[2] & 3) << 8;
    if (bytes[0] != 0xAA || length < HEADER) exit(2);
    return length <= size ? length : 0;
}

static void put(int fd, const uint8_t *bytes, int size) {
    if (write(fd, bytes, size) != size) exit(3);
}

static void be_raw(int fd) {
    struct termios settings;
    tcgetattr(fd, &settings);
    cfmakeraw(&settings);
    tcsetattr(fd, TCSANOW, &settings);
}

static int answer(void) {
    int master = posix_openpt(O_RDWR | O_NOCTTY);
    if (master < 0 || grantpt(master) || unlockpt(master)) return 4;
    int slave = open(ptsname(master), O_RDWR | O_NOCTTY); /* held: none open is a hang-up */
    if (slave < 0) return 4;
    be_raw(slave);
    printf("%s\n", ptsname(master));
    fflush(stdout);
    uint8_t bytes[8 * MOST], frame[MOST + 1];
    int have = 0;
    struct pollfd ends[2] = {{.fd = master, .events = POLLIN}, {.fd = 0, .events = POLLIN}};
    while (poll(ends, 2, -1) > 0 && !ends[1].revents) {
        int got = read(master, bytes + have, sizeof bytes - have);
        if (got <= 0) return 5;
        have += got;
        for (int length; (length = whole(bytes, have)) > 0;) {
            const uint8_t data[2] = {0, 0};
            int number = bytes[8] | bytes[9] << 8, session = bytes[3] & 31;
            if (session) put(master, frame, encode(frame, data, 2, session, 1, number));
            memmove(bytes, bytes + length, have -= length);
        }
    }
    return 0;
}

static double seconds(clockid_t clock) {
    struct timespec now;
    clock_gettime(clock, &now);
    return now.tv_sec + now.tv_nsec * 1e-9;
}

static int later(const void *one, const void *other) {
    double a = *(const double *)one, b = *(const double *)other;
    return (a > b) - (a < b);
}

static int ask(const char *path) {
    int fd = open(path, O_RDWR | O_NOCTTY | O_NONBLOCK), count, number = 0;
    if (fd < 0) return 6;
    be_raw(fd);
    uint8_t frame[MOST + 1], bytes[4096];
    const uint8_t data[DATA] = {0};
    while (scanf("%d", &count) == 1) {
        double *took = malloc(count * sizeof *took), spent = seconds(CLOCK_THREAD_CPUTIME_ID);
        for (int at = 0; at < count; at++) {
            struct pollfd wait = {.fd = fd, .events = POLLIN};
            double began = seconds(CLOCK_MONOTONIC);
            put(fd, frame, encode(frame, data, DATA, 2, 0, number++ & 0xFFFF));
            for (int have = 0; !have || !whole(bytes, have);) {
                if (poll(&wait, 1, -1) != 1) return 7;
                int got = read(fd, bytes + have, sizeof bytes - have);
                if (got <= 0) return 7;
                have += got;
            }
            took[at] = seconds(CLOCK_MONOTONIC) - began;
        }
        spent = (seconds(CLOCK_THREAD_CPUTIME_ID) - spent) / count;
        qsort(took, count, sizeof *took, later);
        printf("%.9f %.9f\n", spent, took[count / 2]);
        fflush(stdout);
        free(took);
    }
    return 0;
}

int main(int count, char **arguments) {
    make_tables();
    if (count == 2 && !strcmp(arguments[1], "answer")) return answer();
    if (count == 3 && !strcmp(arguments[1], "ask")) return ask(arguments[2]);
    return 1;
}
