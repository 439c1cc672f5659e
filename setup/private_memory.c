// The shared memory of Fast DDS belongs to its user alone.
//
// Images, results and commands of the nodes pass through /dev/shm. Boost.Interprocess gives each of these files the mode
// 0644 by fchmod, whatever the umask is, and Fast DDS has no setting for it: every user of the computer could read what the
// camera sees. setup/environment.sh loads this before the C library.

#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

// of version 2, and of later ones
static const char *const beginnings[] = {"/dev/shm/fastrtps_", "/dev/shm/fastdds_"};

int fchmod(int file, mode_t mode)
{
    static int (*of_the_c_library)(int, mode_t); // every thread finds the same
    char link[32], name[32] = "";

    if (!of_the_c_library)
        of_the_c_library = (int (*)(int, mode_t))dlsym(RTLD_NEXT, "fchmod");
    snprintf(link, sizeof link, "/proc/self/fd/%d", file);
    if (readlink(link, name, sizeof name - 1) > 0)
        for (int i = 0; i < 2; i++)
            if (!strncmp(name, beginnings[i], strlen(beginnings[i])))
                mode &= S_IRUSR | S_IWUSR;
    return of_the_c_library(file, mode);
}
