#include "figures.h"

#include "semihosting.h"

enum { CALIBRATION_LOOPS = 100000 };

int fail(const char *what, const char *why)
{
    semihost_puts("firmware: ");
    semihost_puts(what);
    semihost_puts(": ");
    semihost_puts(why);
    semihost_puts("\n");
    return 1;
}

void print_figure(const char *name, uint32_t value)
{
    semihost_puts("firmware: ");
    semihost_puts(name);
    semihost_puts(" ");
    semihost_put_u32(value);
    semihost_puts("\n");
}

uint32_t calibrate(void)
{
    uint32_t ticks[2];
    int i;
    for (i = 0; i < 2; ++i) {
        const uint32_t start = ticks_now();
        spin(CALIBRATION_LOOPS);
        ticks[i] = ticks_since(start);
    }
    if (ticks[0] == 0 || ticks[0] + 1 < ticks[1] || ticks[1] + 1 < ticks[0]) {
        return 0;
    }
    return 2u * CALIBRATION_LOOPS * 1000u / ticks[1];
}
