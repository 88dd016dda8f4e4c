/* A clock of the day that jumps with each look at it, or shows one year of all. To be loaded before a program. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <time.h>

int clock_gettime(clockid_t id, struct timespec *at) {
    static int (*real)(clockid_t, struct timespec *);
    static atomic_int looks;
    static const long long years[] = {0, 40, -20, -100, 20000};
    if (!real) real = (int (*)(clockid_t, struct timespec *))dlsym(RTLD_NEXT, "clock_gettime");
    int result = real(id, at);
    const char *always = getenv("CLOCK_YEARS");
    if (result == 0 && id == CLOCK_REALTIME) at->tv_sec += 31556952 * (always ? atoll(always) : years[atomic_fetch_add(&looks, 1) % 5]);
    return result;
}
