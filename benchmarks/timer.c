/* How late a loop of timerfd and epoll wakes, without an event loop.
 *
 *   timer HZ    per line of input a number: waits for as many ticks, prints the median and the
 *               99th percentile of their lateness, in s
 */
#define _GNU_SOURCE
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/epoll.h>
#include <sys/timerfd.h>
#include <time.h>
#include <unistd.h>

static double seconds(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec + now.tv_nsec * 1e-9;
}

static int later(const void *one, const void *other) {
    double a = *(const double *)one, b = *(const double *)other;
    return (a > b) - (a < b);
}

int main(int arguments, char **words) {
    if (arguments != 2) return 1;
    double period = 1 / atof(words[1]);
    int timer = timerfd_create(CLOCK_MONOTONIC, TFD_NONBLOCK), loop = epoll_create1(0), count;
    struct epoll_event event = {.events = EPOLLIN};
    if (timer < 0 || epoll_ctl(loop, EPOLL_CTL_ADD, timer, &event)) return 2;
    while (scanf("%d", &count) == 1 && count > 0) {
        double *late = malloc(count * sizeof *late), start = seconds();
        for (int at = 0; at < count; at++) {
            double deadline = start + (at + 1) * period;
            time_t whole = deadline;
            struct itimerspec when = {.it_value = {whole, (deadline - whole) * 1e9}};
            uint64_t rung;
            timerfd_settime(timer, TFD_TIMER_ABSTIME, &when, NULL);
            if (epoll_wait(loop, &event, 1, -1) != 1) return 3;
            if (read(timer, &rung, sizeof rung) != sizeof rung) return 4;
            late[at] = seconds() - deadline;
        }
        qsort(late, count, sizeof *late, later);
        printf("%.9f %.9f\n", late[count / 2], late[count * 99 / 100]);
        fflush(stdout);
        free(late);
    }
    return 0;
}
