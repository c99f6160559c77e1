/* Files that appear whole or not at all: written under another name, then renamed. What is no regular file (a pipe, a device) cannot be replaced:
 * it is written to as it is. */
#ifndef OUTPUT_H
#define OUTPUT_H
#include "report.h"

typedef struct {
    FILE *file;
    char *temporary;      /* its name until it is whole; NULL if it is written in place */
} Output;

/* A pipe or a device: written to, never replaced by a file. */
bool output_special(const char *path);
/* False with an error if it cannot be written. After a true, close with output_close. */
bool output_open(Output *output, const char *path, Report *report);
/* 'good' is whether all went well so far, with errno set if not. False with an error if it did not, or if the file cannot be put in its place: what
 * was there before stays. */
bool output_close(Output *output, const char *path, bool good, Report *report);
/* Asked before a long run: whether its result will have a place. */
bool output_possible(const char *path, Report *report);
#endif
