/* A disk that is full from its k-th write on, for every library of a process: by LD_PRELOAD.

   FULL_DISK names a file of the form `struct control`, which all processes map and the test sets.
   Counted below `folder`: writes of data, files made longer, files and folders made. Number `at`
   itself, where it writes more than a byte, writes half of it, as a real disk does; all later ones
   fail with ENOSPC, until `at` is set back to 0. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/sendfile.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>

struct control { long long count, at, refused; char folder[4072]; };
static struct control *control;

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

__attribute__((constructor)) static void begin(void) {
    const char *path = getenv("FULL_DISK");
    int fd = path ? REAL(open)(path, O_RDWR | O_CLOEXEC) : -1;
    if (fd < 0) return;
    void *at = mmap(NULL, sizeof *control, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    close(fd);
    if (at != MAP_FAILED) control = at;
}

static int below(const char *path) {
    size_t n = strlen(control->folder);
    return n && !strncmp(path, control->folder, n) && (path[n] == '/' || path[n] == 0);
}

static int file_below(int fd) {
    char link[64], path[PATH_MAX];
    if (!control) return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t n = readlink(link, path, sizeof path - 1);
    if (n < 0) return 0;
    path[n] = 0;
    return below(path);
}

static int path_below(int folder, const char *path) {
    char whole[2 * PATH_MAX], link[64], base[PATH_MAX];
    if (!control || !path) return 0;
    if (path[0] == '/') return below(path);
    if (folder == AT_FDCWD) {
        if (!getcwd(base, sizeof base)) return 0;
    } else {
        snprintf(link, sizeof link, "/proc/self/fd/%d", folder);
        ssize_t n = readlink(link, base, sizeof base - 1);
        if (n < 0) return 0;
        base[n] = 0;
    }
    while (!strncmp(path, "../", 3)) { /* relative paths of the service: above the catalogues */
        char *slash = strrchr(base, '/');
        if (!slash) return 0;
        *slash = 0;
        path += 3;
    }
    snprintf(whole, sizeof whole, "%s/%s", base, path);
    return below(whole);
}

/* 0: there is room; 1: this is the last write, of half its length; -1: the disk is full */
static int room(void) {
    int e = errno;
    long long mine = __atomic_add_fetch(&control->count, 1, __ATOMIC_SEQ_CST), at = control->at;
    errno = e;
    if (at <= 0 || mine < at) return 0;
    __atomic_add_fetch(&control->refused, 1, __ATOMIC_SEQ_CST);
    if (mine == at) return 1;
    errno = ENOSPC;
    return -1;
}

static int refused(void) { errno = ENOSPC; return -1; }

#define WRITES(declared, called, name, length)                            \
    ssize_t declared {                                                    \
        int r = file_below(fd) ? room() : 0;                              \
        if (r < 0 || (r > 0 && length < 2)) return refused();             \
        if (r > 0) length /= 2;                                           \
        return REAL(name) called;                                         \
    }
WRITES(write(int fd, const void *b, size_t n), (fd, b, n), write, n)
WRITES(pwrite(int fd, const void *b, size_t n, off_t o), (fd, b, n, o), pwrite, n)
WRITES(pwrite64(int fd, const void *b, size_t n, off64_t o), (fd, b, n, o), pwrite64, n)
WRITES(writev(int fd, const struct iovec *v, int n), (fd, v, n), writev, n)
WRITES(pwritev(int fd, const struct iovec *v, int n, off_t o), (fd, v, n, o), pwritev, n)
WRITES(pwritev64(int fd, const struct iovec *v, int n, off64_t o), (fd, v, n, o), pwritev64, n)
WRITES(sendfile(int fd, int in, off_t *o, size_t n), (fd, in, o, n), sendfile, n)
WRITES(sendfile64(int fd, int in, off64_t *o, size_t n), (fd, in, o, n), sendfile64, n)
WRITES(copy_file_range(int in, off64_t *i, int fd, off64_t *o, size_t n, unsigned f),
       (in, i, fd, o, n, f), copy_file_range, n)

#define GROWS(declared, called, name, fails)                              \
    int declared {                                                        \
        if (file_below(fd) && room()) return fails;                       \
        return REAL(name) called;                                         \
    }
static int longer(int fd, off64_t size) {
    struct stat64 now;
    return fstat64(fd, &now) == 0 && size > now.st_size;
}
int ftruncate(int fd, off_t size) {
    if (file_below(fd) && longer(fd, size) && room()) return refused();
    return REAL(ftruncate)(fd, size);
}
int ftruncate64(int fd, off64_t size) {
    if (file_below(fd) && longer(fd, size) && room()) return refused();
    return REAL(ftruncate64)(fd, size);
}
GROWS(fallocate(int fd, int m, off_t o, off_t n), (fd, m, o, n), fallocate, refused())
GROWS(fallocate64(int fd, int m, off64_t o, off64_t n), (fd, m, o, n), fallocate64, refused())
GROWS(posix_fallocate(int fd, off_t o, off_t n), (fd, o, n), posix_fallocate, ENOSPC)
GROWS(posix_fallocate64(int fd, off64_t o, off64_t n), (fd, o, n), posix_fallocate64, ENOSPC)

static int makes(int folder, const char *path, int flags) {
    return (flags & O_CREAT) && path_below(folder, path) && faccessat(folder, path, F_OK, 0)
        && room();
}
#define OPENS(name)                                                       \
    int name(const char *path, int flags, ...) {                          \
        va_list more; va_start(more, flags);                              \
        mode_t mode = flags & (O_CREAT | __O_TMPFILE) ? va_arg(more, mode_t) : 0; \
        va_end(more);                                                     \
        int e = errno;                                                    \
        if (makes(AT_FDCWD, path, flags)) return refused();               \
        errno = e;                                                        \
        return REAL(name)(path, flags, mode);                             \
    }
OPENS(open)
OPENS(open64)
#define OPENS_AT(name)                                                    \
    int name(int folder, const char *path, int flags, ...) {              \
        va_list more; va_start(more, flags);                              \
        mode_t mode = flags & (O_CREAT | __O_TMPFILE) ? va_arg(more, mode_t) : 0; \
        va_end(more);                                                     \
        int e = errno;                                                    \
        if (makes(folder, path, flags)) return refused();                 \
        errno = e;                                                        \
        return REAL(name)(folder, path, flags, mode);                     \
    }
OPENS_AT(openat)
OPENS_AT(openat64)
int mkdir(const char *path, mode_t mode) {
    int e = errno;
    if (path_below(AT_FDCWD, path) && access(path, F_OK) && room()) return refused();
    errno = e;
    return REAL(mkdir)(path, mode);
}
int mkdirat(int folder, const char *path, mode_t mode) {
    int e = errno;
    if (path_below(folder, path) && faccessat(folder, path, F_OK, 0) && room()) return refused();
    errno = e;
    return REAL(mkdirat)(folder, path, mode);
}
