/* Calls that write below a folder can be counted, refused, or be the last of the process.
   Preloaded into a process that is to crash; what libraries and SQLite write goes through it, too. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <signal.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static char folder[PATH_MAX];
static int death;      /* whether the process dies at its point */
static int number;     /* error of a refused call */
static int lasting;    /* whether all calls after the point that need room are refused as well */
static long point;
static atomic_long seen;
static char struck[64];

void crash_arm(const char *below, long at, int dies, int error, int goes_on) {
    strncpy(folder, below, sizeof folder - 1);
    if (!folder[0]) return; /* the count stays */
    point = at, death = dies, number = error, lasting = goes_on;
    atomic_store(&seen, 0);
    struck[0] = 0;
}
long crash_seen(void) { return atomic_load(&seen); }
const char *crash_struck(void) { return struck; }

/* True if a call on a path is to fail; it may be the last. */
static int strikes(const char *name, const char *path, int needs_room) {
    if (!folder[0] || strncmp(path, folder, strlen(folder))) return 0;
    if (number == ENOSPC && !needs_room) return 0;
    long now = atomic_fetch_add(&seen, 1) + 1;
    if (now != point && !(lasting && struck[0])) return 0;
    if (!struck[0]) strncpy(struck, name, sizeof struck - 1);
    if (death) kill(getpid(), SIGKILL), pause();
    errno = number;
    return 1;
}
static int strikes_file(const char *name, int file, int needs_room) {
    char link[64], path[PATH_MAX];
    snprintf(link, sizeof link, "/proc/self/fd/%d", file);
    int before = errno;
    ssize_t size = readlink(link, path, sizeof path - 1);
    errno = before;
    if (size < 0) return 0;
    path[size] = 0;
    return strikes(name, path, needs_room);
}

#define REAL(type, name, ...) \
    static type (*real)(__VA_ARGS__); \
    if (!real) real = (type (*)(__VA_ARGS__))dlsym(RTLD_NEXT, name)

#define OPEN(name) \
    int name(const char *path, int flags, ...) { \
        REAL(int, #name, const char *, int, ...); \
        va_list more; va_start(more, flags); \
        mode_t mode = va_arg(more, mode_t); va_end(more); \
        if ((flags & (O_CREAT | O_TRUNC)) && strikes("open", path, 1)) return -1; \
        return real(path, flags, mode); \
    }
OPEN(open)
OPEN(open64)
#define WRITE(name, type) \
    ssize_t name(int file, const void *data, size_t size, type place) { \
        REAL(ssize_t, #name, int, const void *, size_t, type); \
        if (strikes_file(#name, file, 1)) return -1; \
        return real(file, data, size, place); \
    }
WRITE(pwrite, off_t)
WRITE(pwrite64, off64_t)
ssize_t write(int file, const void *data, size_t size) {
    REAL(ssize_t, "write", int, const void *, size_t);
    if (!strikes_file("write", file, 1)) return real(file, data, size);
    /* A full disk takes what it has room for, and refuses the rest. */
    if (number == ENOSPC && atomic_load(&seen) == point && size > 1) return real(file, data, size / 2);
    return -1;
}
#define ON_FILE(name) \
    int name(int file) { \
        REAL(int, #name, int); \
        return strikes_file(#name, file, 0) ? -1 : real(file); \
    }
ON_FILE(fsync)
ON_FILE(fdatasync)
#define ON_PATH(name) \
    int name(const char *path) { \
        REAL(int, #name, const char *); \
        return strikes(#name, path, 0) ? -1 : real(path); \
    }
ON_PATH(unlink)
ON_PATH(rmdir)
int mkdir(const char *path, mode_t mode) {
    REAL(int, "mkdir", const char *, mode_t);
    return strikes("mkdir", path, 1) ? -1 : real(path, mode);
}
int rename(const char *path, const char *place) {
    REAL(int, "rename", const char *, const char *);
    return strikes("rename", path, 0) ? -1 : real(path, place);
}
int ftruncate64(int file, off64_t size) {
    REAL(int, "ftruncate64", int, off64_t);
    return strikes_file("ftruncate", file, 0) ? -1 : real(file, size);
}
