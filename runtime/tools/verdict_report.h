/* How a verdict is told: lines for people and scripts, JSON, JUnit. */
#ifndef AMINN_VERDICT_REPORT_H
#define AMINN_VERDICT_REPORT_H

#include <stdio.h>

#include "comparison.h"

/* Figures to `says`, one "name value" a line; then at most `shown` failures on stderr, worst first, and their number. */
void print_verdict(const verdict_t *verdict, const char *what, size_t shown, FILE *says);

/* One object: the figures by the names that are printed, "ok", and "failures" with all of them. */
void write_json(const verdict_t *verdict, const char *what, const char *path);

/* One test case an output. */
void write_junit(const verdict_t *verdict, const char *what, const char *path);

#endif
