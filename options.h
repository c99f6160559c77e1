/* What the command line says. Knows the options and their words; runs nothing. */
#ifndef OPTIONS_H
#define OPTIONS_H
#include "explain.h"
#include "render.h"

enum { ALL_STRATEGIES = (1 << MUTATIONS) - 1 };

typedef struct {
    Settings settings;
    CameraSettings camera;
    ExplainOptions explain;
    const char *scene, *stats, *save, *resume;     /* NULL if not given */
    const char **output;           /* [outputs], room for each argument and the two default names */
    int outputs, verbosity;        /* -1 quiet, 1 verbose */
    double exposure;
    bool help, version;
} Options;

/* The commands that take these options. */
typedef enum { FOR_RENDER = 1, FOR_EXPLAIN = 2, FOR_MERGE = 4, FOR_SCENE = FOR_RENDER | FOR_EXPLAIN, FOR_ALL = FOR_SCENE | FOR_MERGE } ForCommand;

/* Reads argv[1] .. into options that hold the defaults; operands go to 'operand' (room for argc), their number to *operands.
 * False with an error about usage. */
bool options_read(Options *options, ForCommand command, int argc, char **argv, const char **operand, int *operands, Report *report);

/* Whether mutations are made; the references, and direct light alone, take independent samples. */
bool options_chains(const Settings *settings);

/* Warns of what was asked for and will not be had. */
void options_warn(const Options *options, const Scene *scene, Report *report);

/* A line or more for each option, on standard output. */
void options_help(void);
#endif
