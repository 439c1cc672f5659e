// A wait without limit ends when what is waited for has happened.
//
// Fast DDS waits until the last moment of the steady clock for callbacks that are running, before it destroys a
// participant. In the wheels of ROS 2, built for old C libraries, that moment overflows in the conversion to the time of
// day and becomes negative; the C library refuses it at once, and Fast DDS asks again and again with a mutex locked that the
// callback needs: the process never ends (docs/decisions/0033). setup/environment.sh loads this before the C library.

#define _GNU_SOURCE
#include <dlfcn.h>
#include <pthread.h>
#include <time.h>

typedef int (*timed_wait)(pthread_cond_t *, pthread_mutex_t *, const struct timespec *);

int pthread_cond_timedwait(pthread_cond_t *condition, pthread_mutex_t *mutex, const struct timespec *until)
{
    static timed_wait of_the_c_library; // every thread finds the same
    if (until->tv_sec < 0)
        return pthread_cond_wait(condition, mutex);
    if (!of_the_c_library)
        of_the_c_library = (timed_wait)dlvsym(RTLD_NEXT, "pthread_cond_timedwait", "GLIBC_2.3.2");
    return of_the_c_library(condition, mutex, until);
}
