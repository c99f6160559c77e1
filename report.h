/* How a module tells its caller what is wrong: an error is a text that comes back with a false result and leaves the program in one place;
 * a warning goes to a stream at once. No globals: whoever calls, passes a Report. */
#ifndef REPORT_H
#define REPORT_H
#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>

typedef struct {
    char error[1024];     /* text of the error, without 'mlt: ' and without newline; empty if there is none */
    FILE *warnings;       /* where warnings go, a line each; NULL drops them */
    int warned;           /* warnings so far */
} Report;

/* Sets the error to 'FILE:LINE: text' (FILE: text if line is 0, text alone if file is NULL). Always returns false, to be returned in turn. */
#if defined(__GNUC__)
__attribute__((format(printf, 4, 5)))
#endif
static inline bool report_error(Report *r, const char *file, unsigned long line, const char *format, ...)
{
    int n = 0;
    if (file && line) n = snprintf(r->error, sizeof r->error, "%.600s:%lu: ", file, line);
    else if (file) n = snprintf(r->error, sizeof r->error, "%.600s: ", file);
    va_list args;
    va_start(args, format);
    vsnprintf(r->error + n, sizeof r->error - (size_t)n, format, args);
    va_end(args);
    return false;
}

/* Prints 'mlt: warning: FILE:LINE: text'. */
#if defined(__GNUC__)
__attribute__((format(printf, 4, 5)))
#endif
static inline void report_warning(Report *r, const char *file, unsigned long line, const char *format, ...)
{
    r->warned++;
    if (!r->warnings) return;
    fputs("mlt: warning: ", r->warnings);
    if (file && line) fprintf(r->warnings, "%.600s:%lu: ", file, line);
    else if (file) fprintf(r->warnings, "%.600s: ", file);
    va_list args;
    va_start(args, format);
    vfprintf(r->warnings, format, args);
    va_end(args);
    fputc('\n', r->warnings);
}
#endif
