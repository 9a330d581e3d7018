#include "host_file.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#define ALIGNMENT 64u /* of what a file's bytes begin at: a model's tables are laid out for it */

const char *program_name = "aminn";
int failure_status = 1;

/* Of the output that is being written: the name that the user gave, where it leads, and the half-written file. */
#define PATH_SIZE 4096
#define MAX_LINKS 40 /* as many as Linux follows */
static const char *output_name;
static char output_target[PATH_SIZE], partial_path[PATH_SIZE];
static int to_stdout;

/* Files stay in memory until the program ends; remembered here so that leak checkers know it. */
static void *held[8];

static void hold(void *memory)
{
    static size_t n;
    if (n < sizeof held / sizeof held[0]) {
        held[n++] = memory;
    }
}

void die(const char *format, ...)
{
    va_list args;
    va_start(args, format);
    fprintf(stderr, "%s: ", program_name);
    vfprintf(stderr, format, args);
    fputc('\n', stderr);
    va_end(args);
    if (partial_path[0] != '\0') {
        remove(partial_path);
    }
    exit(failure_status);
}

uint32_t read_magic(const char *path)
{
    FILE *file = fopen(path, "rb");
    uint32_t word = 0;
    if (file == NULL) {
        die("%s: %s", path, strerror(errno));
    }
    if (fread(&word, sizeof word, 1, file) != 1) {
        word = 0;
    }
    fclose(file);
    vector_swap(&word, 1);
    return word;
}

void *read_file(const char *path, size_t *size)
{
    FILE *file = fopen(path, "rb");
    void *bytes = NULL;
    long end = 0;
    if (file == NULL) {
        die("%s: %s", path, strerror(errno));
    }
    if (fseek(file, 0, SEEK_END) != 0 || (end = ftell(file)) < 0 || end == LONG_MAX || fseek(file, 0, SEEK_SET) != 0) {
        die("%s: not a regular file", path);
    }
    if (posix_memalign(&bytes, ALIGNMENT, (size_t)end + 1) != 0) {
        die("%s: out of memory for %ld bytes", path, end);
    }
    hold(bytes);
    if (fread(bytes, 1, (size_t)end, file) != (size_t)end) {
        die("%s: cannot read", path);
    }
    fclose(file);
    *size = (size_t)end;
    return bytes;
}

/* common to both kinds of file: length and CRC */
static const vector_header_t *open_checked(const char *path, const char *(*error_of)(const vector_header_t *, uint64_t))
{
    size_t size = 0;
    vector_header_t *header = read_file(path, &size);
    const char *error = NULL;
    uint32_t crc;
    if (size < sizeof *header) {
        die("%s: truncated: %zu bytes, the header alone has %zu", path, size, sizeof *header);
    }
    crc = vector_crc(0, header + 1, size - sizeof *header);
    vector_swap(header, size / sizeof(uint32_t)); /* of float64 outputs too, which are not used on such machines */
    error = error_of(header, size - sizeof *header);
    if (error != NULL) {
        die("%s: %s", path, error);
    }
    if (crc != header->crc) {
        die("%s: damaged: its CRC-32 does not match", path);
    }
    return header;
}

const vector_header_t *open_vectors(const char *path)
{
    return open_checked(path, vector_header_error);
}

const vector_header_t *open_results(const char *path)
{
    return open_checked(path, result_header_error);
}

void open_model(const char *path, aminn_model_t *model)
{
    size_t size = 0;
    const void *bytes = read_file(path, &size);
    const aminn_status_t status = aminn_model_from_blob(bytes, size, model);
    if (status != AMINN_OK) {
        die("%s: %s: %s", path, aminn_status_name(status), aminn_status_text(status));
    }
}

/* ---- writing ---- */

static void cannot_write(int error)
{
    die("%s: cannot write: %s", output_name, strerror(error));
}

void refuse_input(const char *out, const char *input)
{
    struct stat a, b;
    if (stat(out, &a) == 0 && stat(input, &b) == 0 && S_ISREG(a.st_mode) && a.st_dev == b.st_dev &&
        a.st_ino == b.st_ino) {
        die("%s: is the input %s; choose another name for the output", out, input);
    }
}

/* Number of the descriptor that `path` names, -1 if it is another path. */
static int descriptor_of(const char *path)
{
    static const char *const folders[] = {"/dev/fd/", "/proc/self/fd/"};
    size_t i;
    if (strcmp(path, "/dev/stdout") == 0) {
        return STDOUT_FILENO;
    }
    for (i = 0; i < sizeof folders / sizeof folders[0]; ++i) {
        const size_t length = strlen(folders[i]);
        if (strncmp(path, folders[i], length) == 0) {
            char *end = NULL;
            const long n = strtol(path + length, &end, 10);
            return end != path + length && *end == '\0' && n >= 0 && n <= INT_MAX ? (int)n : -1;
        }
    }
    return -1;
}

/* Follows the links of output_target until a descriptor, which it returns, or a path that is no link: -1. */
static int follow_links(void)
{
    int i;
    for (i = 0; i < MAX_LINKS; ++i) {
        char link[PATH_SIZE];
        char *slash = strrchr(output_target, '/');
        const int descriptor = descriptor_of(output_target);
        const ssize_t length = descriptor < 0 ? readlink(output_target, link, sizeof link - 1) : -1;
        size_t folder;
        if (length < 0) {
            return descriptor;
        }
        link[length] = '\0';
        folder = link[0] == '/' || slash == NULL ? 0 : (size_t)(slash + 1 - output_target);
        if (folder + (size_t)length >= sizeof output_target) {
            cannot_write(ENAMETOOLONG);
        }
        memcpy(output_target + folder, link, (size_t)length + 1);
    }
    cannot_write(ELOOP);
    return -1;
}

static FILE *stream_of(int descriptor)
{
    FILE *file = descriptor < 0 ? NULL : fdopen(descriptor, "wb");
    if (file == NULL) {
        cannot_write(errno);
    }
    return file;
}

/* A new file beside the target, which `old` describes if it is there. */
static FILE *create_partial(const struct stat *old)
{
    int descriptor;
    if (snprintf(partial_path, sizeof partial_path, "%s.%ld.partial", output_target, (long)getpid()) >=
        (int)sizeof partial_path) {
        partial_path[0] = '\0';
        cannot_write(ENAMETOOLONG);
    }
    descriptor = open(partial_path, O_WRONLY | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC, 0666);
    if (descriptor < 0) {
        const int error = errno;
        partial_path[0] = '\0';
        cannot_write(error);
    }
    if (old != NULL) {
        /* as far as this user may give it away */
        const int given = fchown(descriptor, old->st_uid, old->st_gid);
        (void)given;
        if (fchmod(descriptor, old->st_mode & 07777) != 0) {
            cannot_write(errno);
        }
    }
    return stream_of(descriptor);
}

FILE *create_output(const char *path)
{
    struct stat target, printed;
    int descriptor, exists;
    signal(SIGXFSZ, SIG_IGN); /* a limit on the size of files ends as a full disk does, with a message */
    output_name = path;
    if (strlen(path) >= sizeof output_target) {
        cannot_write(ENAMETOOLONG);
    }
    strcpy(output_target, path);
    descriptor = follow_links();
    to_stdout = descriptor == STDOUT_FILENO;
    if (descriptor >= 0) {
        return stream_of(dup(descriptor));
    }
    exists = stat(output_target, &target) == 0;
    if (!exists) {
        if (errno != ENOENT) {
            cannot_write(errno);
        }
        return create_partial(NULL);
    }
    if (S_ISREG(target.st_mode)) {
        if (access(output_target, W_OK) != 0) {
            cannot_write(errno);
        }
        return create_partial(&target);
    }
    to_stdout =
        fstat(STDOUT_FILENO, &printed) == 0 && printed.st_dev == target.st_dev && printed.st_ino == target.st_ino;
    return stream_of(open(output_target, O_WRONLY | O_NOCTTY | O_CLOEXEC));
}

void write_output(FILE *file, const void *bytes, size_t size)
{
    if (size > 0 && fwrite(bytes, 1, size, file) != size) {
        cannot_write(errno);
    }
}

/* Copies the half-written file into the target: what something is mounted on cannot be renamed over. */
static void copy_into_target(void)
{
    size_t size = 0;
    const void *bytes = read_file(partial_path, &size);
    FILE *file = fopen(output_target, "wb");
    if (file == NULL || fwrite(bytes, 1, size, file) != size || fclose(file) != 0 || remove(partial_path) != 0) {
        cannot_write(errno);
    }
}

/* Makes a rename last, where the file system knows of such a thing. */
static void sync_folder(void)
{
    char *slash = strrchr(output_target, '/');
    int descriptor;
    if (slash != NULL) {
        slash[slash == output_target] = '\0';
    }
    descriptor = open(slash != NULL ? output_target : ".", O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (descriptor >= 0) {
        (void)fsync(descriptor);
        close(descriptor);
    }
}

void finish_output(FILE *file)
{
    const int whole = partial_path[0] != '\0';
    if (ferror(file) != 0) {
        cannot_write(EIO);
    }
    if (fflush(file) != 0 || (whole && fsync(fileno(file)) != 0) || fclose(file) != 0) {
        cannot_write(errno);
    }
    if (whole) {
        if (rename(partial_path, output_target) != 0) {
            if (errno != EBUSY) {
                cannot_write(errno);
            }
            copy_into_target();
        }
        partial_path[0] = '\0';
        sync_folder();
    }
}

int output_is_stdout(void)
{
    return to_stdout;
}
