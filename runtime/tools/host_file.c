#define _POSIX_C_SOURCE 200112L /* posix_memalign */
#include "host_file.h"

#include <errno.h>
#include <limits.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define ALIGNMENT 64u /* of what a file's bytes begin at: a model's tables are laid out for it */

const char *program_name = "aminn";
int failure_status = 1;
char partial_path[4096];

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
