/* A disk that fails when told to, and a clock that is wrong: preloaded into a program (LD_PRELOAD).
 *
 * Every call that changes what stands under one folder has a number: open for writing, write, truncate, fsync, close,
 * rename, unlink, rmdir, mkdir. A range of numbers can be made to fail, to write half, or to end the process, and all
 * of them are recorded for disk.py, which works out what a cut of power at each would leave.
 *
 * The record, native byte order, one entry a call that succeeded:
 *   char what; int64 handle, offset, n_path, n_rest; n_path bytes of path; n_rest bytes of data or second path
 * A handle is the number of an open file; the same file may have several. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <pthread.h>
#include <signal.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/sendfile.h>
#include <sys/stat.h>
#include <sys/time.h>
#include <sys/uio.h>
#include <time.h>
#include <unistd.h>

enum { MAX_FILES = 4096, HALF = -1, KILL = -2 };

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static char folder[PATH_MAX];
static int record = -1;
static int64_t handle_of[MAX_FILES], handles;
static int writes_to[MAX_FILES];
static int64_t calls, first_bad, last_bad, every = 1;
static int failure;
static char kinds[32];
static double clock_offset_s;

#define REAL(name) ((__typeof__(&name))real(#name))

static void *real(const char *name)
{
    return dlsym(RTLD_NEXT, name);
}

/* Watch a folder (an absolute path without links); `log`: where to record, or NULL. */
void faults_watch(const char *path, const char *log)
{
    record = log ? REAL(open)(log, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0600) : -1;
    calls = 0;
    snprintf(folder, sizeof folder, "%s", path);
}

/* Of calls `first` to `last` (from 1) whose kind is in `only` (letters of the record; "" for all), let each `step`th
 * one fail with errno `error`, write HALF, or KILL the process. */
void faults_arm(int64_t first, int64_t last, int64_t step, int error, const char *only)
{
    first_bad = first, last_bad = last, every = step, failure = error;
    snprintf(kinds, sizeof kinds, "%s", only);
}

/* Calls so far. */
int64_t faults_calls(void)
{
    return calls;
}

/* What is added to the time of day. */
void faults_clock(double offset_s)
{
    clock_offset_s = offset_s;
}

/* Where a name leads, its folder's links followed; whether that is in the watched folder. */
static int is_watched(int at, const char *name, char *out)
{
    char given[2 * PATH_MAX], base[PATH_MAX] = "";
    if (!folder[0] || !name) {
        return 0;
    }
    if (name[0] != '/') {
        char link[64];
        snprintf(link, sizeof link, "/proc/self/fd/%d", at);
        ssize_t n = at == AT_FDCWD ? (getcwd(base, sizeof base) ? (ssize_t)strlen(base) : -1)
                                   : readlink(link, base, sizeof base - 1);
        if (n < 0) {
            return 0;
        }
        base[n] = 0;
    }
    snprintf(given, sizeof given, "%s%s%s", base, base[0] ? "/" : "", name);
    for (size_t n = strlen(given); n > 1 && given[n - 1] == '/'; n--) {
        given[n - 1] = 0;
    }
    char *slash = strrchr(given, '/'), parent[PATH_MAX];
    *slash = 0;
    if (!realpath(given[0] ? given : "/", parent)) {
        return 0;
    }
    if ((size_t)snprintf(out, PATH_MAX, "%s/%s", strcmp(parent, "/") ? parent : "", slash + 1) >= PATH_MAX) {
        return 0;
    }
    size_t n = strlen(folder);
    return !strncmp(out, folder, n) && (out[n] == '/' || !out[n]);
}

static int is_handle(int fd)
{
    return fd >= 0 && fd < MAX_FILES && handle_of[fd];
}

/* Count a call; its failure, 0 for none. */
static int number(char kind)
{
    calls++;
    int bad = calls >= first_bad && calls <= last_bad && (calls - first_bad) % every == 0;
    if (!bad || (kinds[0] && !strchr(kinds, kind))) {
        return 0;
    }
    if (failure == KILL) {
        kill(getpid(), SIGKILL);
    }
    return failure;
}

static void note(char what, int64_t handle, int64_t offset, const char *path, const void *rest, size_t n_rest)
{
    int64_t head[4] = {handle, offset, (int64_t)strlen(path), (int64_t)n_rest};
    if (record < 0) {
        return;
    }
    struct iovec parts[4] = {{&what, 1}, {head, sizeof head}, {(void *)path, strlen(path)}, {(void *)rest, n_rest}};
    if (REAL(writev)(record, parts, 4) < 0) {
        abort();
    }
}

#define FAIL_OR(kind, call)                     \
    (__extension__({                            \
        int bad_ = number(kind);                \
        bad_ > 0 ? (errno = bad_, -1) : (call); \
    }))

/* --- opening ------------------------------------------------------------------------------------------------------ */
static int open_any(int at, const char *name, int flags, mode_t mode)
{
    char path[PATH_MAX];
    if (!is_watched(at, name, path)) {
        return REAL(openat)(at, name, flags, mode);
    }
    int changes = (flags & O_ACCMODE) != O_RDONLY || flags & (O_CREAT | O_TRUNC);
    pthread_mutex_lock(&lock);
    int fd = changes ? FAIL_OR('o', REAL(openat)(at, name, flags, mode)) : REAL(openat)(at, name, flags, mode);
    if (fd >= MAX_FILES) {
        abort();
    }
    if (fd >= 0) {
        handle_of[fd] = ++handles;
        writes_to[fd] = changes;
        note('o', handles, flags & O_TRUNC ? 0 : -1, path, "", 0);
    }
    pthread_mutex_unlock(&lock);
    return fd;
}

#define OPEN(name, at, ...)                                                     \
    int name(__VA_ARGS__, int flags, ...)                                       \
    {                                                                           \
        va_list more;                                                           \
        va_start(more, flags);                                                  \
        mode_t mode = flags & (O_CREAT | O_TMPFILE) ? va_arg(more, mode_t) : 0; \
        va_end(more);                                                           \
        return open_any(at, path, flags, mode);                                 \
    }
OPEN(open, AT_FDCWD, const char *path)
OPEN(open64, AT_FDCWD, const char *path)
OPEN(openat, at, int at, const char *path)
OPEN(openat64, at, int at, const char *path)

int __open64_2(const char *path, int flags)
{
    return open_any(AT_FDCWD, path, flags, 0);
}

int __openat64_2(int at, const char *path, int flags)
{
    return open_any(at, path, flags, 0);
}

int close(int fd)
{
    if (!is_handle(fd)) {
        return REAL(close)(fd);
    }
    pthread_mutex_lock(&lock);
    int bad = writes_to[fd] ? number('c') : 0; /* the descriptor is gone all the same, as on Linux */
    note('c', handle_of[fd], 0, "", "", 0);
    handle_of[fd] = 0;
    int status = REAL(close)(fd);
    pthread_mutex_unlock(&lock);
    return bad > 0 ? (errno = bad, -1) : status;
}

/* --- content ------------------------------------------------------------------------------------------------------ */
static ssize_t write_any(int fd, const void *data, size_t n, off_t offset)
{
    pthread_mutex_lock(&lock);
    struct stat now;
    fstat(fd, &now);
    int appends = fcntl(fd, F_GETFL) & O_APPEND, here = offset < 0;
    off_t at = appends ? now.st_size : here ? lseek(fd, 0, SEEK_CUR) : offset;
    int bad = number('w');
    size_t wanted = bad == HALF ? (n + 1) / 2 : n;
    ssize_t done =
        bad > 0 ? (errno = bad, -1) : (here ? REAL(write)(fd, data, wanted) : REAL(pwrite)(fd, data, wanted, offset));
    if (done > 0) {
        note('w', handle_of[fd], at, "", data, (size_t)done);
    }
    pthread_mutex_unlock(&lock);
    return done;
}

ssize_t write(int fd, const void *data, size_t n)
{
    return is_handle(fd) ? write_any(fd, data, n, -1) : REAL(write)(fd, data, n);
}

ssize_t pwrite(int fd, const void *data, size_t n, off_t offset)
{
    return is_handle(fd) ? write_any(fd, data, n, offset) : REAL(pwrite)(fd, data, n, offset);
}

ssize_t pwrite64(int fd, const void *data, size_t n, off_t offset)
{
    return pwrite(fd, data, n, offset);
}

ssize_t writev(int fd, const struct iovec *parts, int count)
{
    return is_handle(fd) && count ? write_any(fd, parts->iov_base, parts->iov_len, -1) : REAL(writev)(fd, parts, count);
}

ssize_t sendfile(int out, int in, off_t *offset, size_t n)
{
    if (is_handle(out)) {
        errno = EINVAL; /* so that it is read and written */
        return -1;
    }
    return REAL(sendfile)(out, in, offset, n);
}

int ftruncate(int fd, off_t size)
{
    if (!is_handle(fd)) {
        return REAL(ftruncate)(fd, size);
    }
    pthread_mutex_lock(&lock);
    int status = FAIL_OR('t', REAL(ftruncate)(fd, size));
    if (!status) {
        note('t', handle_of[fd], size, "", "", 0);
    }
    pthread_mutex_unlock(&lock);
    return status;
}

int ftruncate64(int fd, off_t size)
{
    return ftruncate(fd, size);
}

int fsync(int fd)
{
    if (!is_handle(fd)) {
        return REAL(fsync)(fd);
    }
    pthread_mutex_lock(&lock);
    int status = FAIL_OR('s', 0); /* nothing here loses power: there is nothing to wait for */
    if (!status) {
        note('s', handle_of[fd], 0, "", "", 0);
    }
    pthread_mutex_unlock(&lock);
    return status;
}

int fdatasync(int fd)
{
    return fsync(fd);
}

/* --- names -------------------------------------------------------------------------------------------------------- */
static int rename_any(int from_at, const char *from, int to_at, const char *to)
{
    char a[PATH_MAX], b[PATH_MAX];
    int mine = is_watched(from_at, from, a), theirs = is_watched(to_at, to, b);
    if (!mine && !theirs) {
        return REAL(renameat)(from_at, from, to_at, to);
    }
    if (mine != theirs) {
        abort(); /* into or out of the watched folder: the record could not say what comes */
    }
    pthread_mutex_lock(&lock);
    int status = FAIL_OR('r', REAL(renameat)(from_at, from, to_at, to));
    if (!status) {
        note('r', 0, 0, a, b, strlen(b));
    }
    pthread_mutex_unlock(&lock);
    return status;
}

int rename(const char *from, const char *to)
{
    return rename_any(AT_FDCWD, from, AT_FDCWD, to);
}

int renameat(int from_at, const char *from, int to_at, const char *to)
{
    return rename_any(from_at, from, to_at, to);
}

static int named(char kind, int at, const char *name, int flags, mode_t mode)
{
    char path[PATH_MAX];
    int watched = is_watched(at, name, path);
    if (!watched) {
        return kind == 'm' ? REAL(mkdirat)(at, name, mode) : REAL(unlinkat)(at, name, flags);
    }
    pthread_mutex_lock(&lock);
    int status = FAIL_OR(kind, kind == 'm' ? REAL(mkdirat)(at, name, mode) : REAL(unlinkat)(at, name, flags));
    if (!status) {
        note(kind, 0, 0, path, "", 0);
    }
    pthread_mutex_unlock(&lock);
    return status;
}

int mkdir(const char *path, mode_t mode)
{
    return named('m', AT_FDCWD, path, 0, mode);
}

int mkdirat(int at, const char *path, mode_t mode)
{
    return named('m', at, path, 0, mode);
}

int unlink(const char *path)
{
    return named('u', AT_FDCWD, path, 0, 0);
}

int rmdir(const char *path)
{
    return named('u', AT_FDCWD, path, AT_REMOVEDIR, 0);
}

int unlinkat(int at, const char *path, int flags)
{
    return named('u', at, path, flags, 0);
}

/* No program here makes links, and the record has no entry for them. */
int link(const char *from, const char *to)
{
    char path[PATH_MAX];
    if (is_watched(AT_FDCWD, to, path)) {
        abort();
    }
    return REAL(link)(from, to);
}

int symlink(const char *from, const char *to)
{
    char path[PATH_MAX];
    if (is_watched(AT_FDCWD, to, path)) {
        abort();
    }
    return REAL(symlink)(from, to);
}

/* --- the time of day ---------------------------------------------------------------------------------------------- */
int clock_gettime(clockid_t id, struct timespec *out)
{
    int status = REAL(clock_gettime)(id, out);
    if (!status && id == CLOCK_REALTIME) {
        out->tv_sec += (time_t)clock_offset_s;
    }
    return status;
}

int gettimeofday(struct timeval *restrict out, void *restrict zone)
{
    (void)zone;
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    *out = (struct timeval){now.tv_sec, now.tv_nsec / 1000};
    return 0;
}

time_t time(time_t *out)
{
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    return out ? (*out = now.tv_sec) : now.tv_sec;
}
