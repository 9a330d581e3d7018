/* Arm semihosting: files, console, command line and exit of the host that runs the emulator (or the debugger). */
#ifndef SEMIHOSTING_H
#define SEMIHOSTING_H

#include <stddef.h>
#include <stdint.h>

/* Of the machine's own part: the call that the host answers. */
int32_t semihost_call(uint32_t operation, const void *arguments);

enum { SEMIHOST_READ = 1 /* "rb" */, SEMIHOST_WRITE = 7 /* "w+b" */ };

/* Handle of a file, or -1. */
int semihost_open(const char *path, int mode);
/* 0, or the number of bytes that were not transferred. */
size_t semihost_read(int file, void *bytes, size_t n);
size_t semihost_write(int file, const void *bytes, size_t n);
/* 0 if it worked. */
int semihost_seek(int file, uint32_t offset);
int semihost_close(int file);
/* Bytes in the file, or -1. */
int32_t semihost_length(int file);
/* Command line as one string; 0 if it worked. */
int semihost_command_line(char *text, size_t size);

void semihost_puts(const char *text);
void semihost_put_u32(uint32_t value);
void semihost_put_hex(uint32_t value);

/* Ends the emulator with this status. */
__attribute__((noreturn)) void semihost_exit(int status);

#endif
