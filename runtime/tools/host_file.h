/*
 * Reading and writing whole files on a host, with a message and failure_status on every failure. For the command line
 * tools.
 */
#ifndef AMINN_HOST_FILE_H
#define AMINN_HOST_FILE_H

/* posix_memalign and clock_gettime of the system's headers: this one is the first of a source. */
#ifndef _POSIX_C_SOURCE
#define _POSIX_C_SOURCE 200809L
#endif

#include <stdio.h>

#include "aminn_rt.h"
#include "vector_file.h"

/* Set once by main: stands before every message, and what die() ends the program with (1 unless set). */
extern const char *program_name;
extern int failure_status;

#if defined(__GNUC__)
__attribute__((noreturn, format(printf, 1, 2)))
#endif
void die(const char *format, ...);

/* The first word of a file, which says of what kind it is; 0 if it is shorter. */
uint32_t read_magic(const char *path);

/* Whole file in memory that malloc aligned, kept until the program ends; *size is set. */
void *read_file(const char *path, size_t *size);

/* Header of a checked vector file; the samples lie behind it. */
const vector_header_t *open_vectors(const char *path);

/* Header of a checked result file; the rows and status codes lie behind it. */
const vector_header_t *open_results(const char *path);

/* A checked model blob. */
void open_model(const char *path, aminn_model_t *model);

/* Dies if `out` is the file `input`, by whatever path, link or hard link. */
void refuse_input(const char *out, const char *input);

/*
 * An output, one at a time: begun here, whole under its name after finish_output, and gone if the program dies between.
 * A regular file is replaced at once and keeps its mode and owner; links are followed. A device, a FIFO, and what this
 * program prints to (/dev/stdout) are written into.
 */
FILE *create_output(const char *path);
void write_output(FILE *file, const void *bytes, size_t size);
void finish_output(FILE *file);

/* Whether the last output went to where this program prints. */
int output_is_stdout(void);

#endif
