#include "semihosting.h"

#include <string.h>

enum {
    SYS_OPEN = 0x01,
    SYS_CLOSE = 0x02,
    SYS_WRITE0 = 0x04,
    SYS_WRITE = 0x05,
    SYS_READ = 0x06,
    SYS_SEEK = 0x0A,
    SYS_FLEN = 0x0C,
    SYS_GET_CMDLINE = 0x15,
    SYS_EXIT_EXTENDED = 0x20,
};

static const uint32_t ADP_STOPPED_APPLICATION_EXIT = 0x20026u;

int semihost_open(const char *path, int mode)
{
    const uint32_t arguments[3] = {(uint32_t)(uintptr_t)path, (uint32_t)mode, strlen(path)};
    return semihost_call(SYS_OPEN, arguments);
}

size_t semihost_read(int file, void *bytes, size_t n)
{
    const uint32_t arguments[3] = {(uint32_t)file, (uint32_t)(uintptr_t)bytes, n};
    return (size_t)semihost_call(SYS_READ, arguments);
}

size_t semihost_write(int file, const void *bytes, size_t n)
{
    const uint32_t arguments[3] = {(uint32_t)file, (uint32_t)(uintptr_t)bytes, n};
    return (size_t)semihost_call(SYS_WRITE, arguments);
}

int semihost_seek(int file, uint32_t offset)
{
    const uint32_t arguments[2] = {(uint32_t)file, offset};
    return semihost_call(SYS_SEEK, arguments);
}

int semihost_close(int file)
{
    const uint32_t arguments[1] = {(uint32_t)file};
    return semihost_call(SYS_CLOSE, arguments);
}

int32_t semihost_length(int file)
{
    const uint32_t arguments[1] = {(uint32_t)file};
    return semihost_call(SYS_FLEN, arguments);
}

int semihost_command_line(char *text, size_t size)
{
    uint32_t arguments[2] = {(uint32_t)(uintptr_t)text, size};
    return semihost_call(SYS_GET_CMDLINE, arguments);
}

void semihost_puts(const char *text)
{
    semihost_call(SYS_WRITE0, text);
}

void semihost_put_u32(uint32_t value)
{
    char text[11];
    char *digit = text + sizeof text - 1;
    *digit = '\0';
    do {
        *--digit = (char)('0' + value % 10u);
        value /= 10u;
    } while (value != 0);
    semihost_puts(digit);
}

void semihost_put_hex(uint32_t value)
{
    char text[11] = "0x";
    int i;
    for (i = 0; i < 8; ++i) {
        text[2 + i] = "0123456789abcdef"[(value >> (28 - 4 * i)) & 15u];
    }
    text[10] = '\0';
    semihost_puts(text);
}

void semihost_exit(int status)
{
    const uint32_t arguments[2] = {ADP_STOPPED_APPLICATION_EXIT, (uint32_t)status};
    for (;;) {
        semihost_call(SYS_EXIT_EXTENDED, arguments);
    }
}
