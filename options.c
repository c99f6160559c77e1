/* Options of the command line: read, checked, explained. See options.h. */
#include "options.h"
#include "obj.h"
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { SIDE_MAX = 65535 };
static const double pixels_max = 1 << 28, whole_max = 0x1p53;    /* what image_read takes; what a double counts without gaps */

typedef enum { OUTPUT, SIZE, EYE, LOOK, UP, FOV, APERTURE, FOCUS, PER_PIXEL, TIME, ERROR, SEED, INTEGRATOR, STRATEGIES, DIRECT, MAX_DEPTH,
               BOOTSTRAP, CHAINS, EXPOSURE, SAVE, RESUME, STATS,
               STRATEGY, ACCEPTED, LENGTH, EXAMPLE, AUDIT, QUIET, VERBOSE, HELP, VERSION, OPTIONS } OptionCode;

typedef struct {
    char letter;
    const char *name, *argument;   /* argument NULL: a switch */
    const char *wanted;            /* 'must be ...' */
    const char *help;
    int commands;                  /* ForCommand, those that take it */
} Option;

static const Option option_table[OPTIONS] = {
    [OUTPUT]     = { 'o', "output", "FILE", "a name that ends in .pfm, .ppm or .png",
                     "image to write: .pfm linear float; .ppm and .png tone-mapped sRGB;\n.error.pfm the standard error of each value; may be repeated\n"
                     "[NAME.pfm and NAME.ppm in the current folder]", FOR_RENDER | FOR_MERGE },
    [SIZE]       = { 's', "size", "WxH", "two whole numbers from 1 to 65535 with an x between, 2^28 pixels at most",
                     "film size [NAME.cam, else 512x512]", FOR_SCENE },
    [EYE]        = { 0, "eye", "X,Y,Z", "three numbers with commas between", "where the camera stands [NAME.cam, else all of the scene is seen]", FOR_SCENE },
    [LOOK]       = { 0, "look", "X,Y,Z", "three numbers with commas between", "what it looks at", FOR_SCENE },
    [UP]         = { 0, "up", "X,Y,Z", "three numbers with commas between, not all 0", "what is up in the picture", FOR_SCENE },
    [FOV]        = { 0, "fov", "DEG", "a number between 0 and 180", "full vertical angle of view", FOR_SCENE },
    [APERTURE]   = { 0, "aperture", "R", "a number, 0 or more", "lens radius [NAME.cam, else 0: a pinhole]", FOR_SCENE },
    [FOCUS]      = { 0, "focus", "D", "a number above 0", "distance of the plane in focus [NAME.cam, else that of what is looked at]", FOR_SCENE },
    [PER_PIXEL]  = { 'n', "mutations", "N", "a number above 0, 1e10 at most",
                     "mutations per pixel; samples per pixel for path and bdpt\n[256, or no limit with -t or -e];\n"
                     "explain: proposals of each strategy, for --audit only [50000]", FOR_SCENE },
    [TIME]       = { 't', "time", "SECONDS", "a number above 0, 1e9 at most", "stop after so long, loading included [no limit]", FOR_RENDER },
    [ERROR]      = { 'e', "error", "E", "a number above 0", "stop when the estimated relative error of the image is E or less", FOR_RENDER },
    [SEED]       = { 0, "seed", "N", "a whole number from 0 to 2^53", "same seed, scene, options and -n: same file, bit for bit [1]", FOR_SCENE },
    [INTEGRATOR] = { 0, "integrator", "NAME", "mlt, bdpt or path", "mlt, or one of the independent references bdpt and path [mlt]", FOR_RENDER },
    [STRATEGIES] = { 0, "strategies", "LIST", "a list of bidir, lens, caustic, chain, subpath, manifold with commas between",
                     "mutations to choose from: bidir,lens,caustic,chain,subpath,manifold\n[those that the scene can use]", FOR_SCENE },
    [DIRECT]     = { 0, "direct", "HOW", "apart, chain, only or none",
                     "direct light: computed apart, left to the chain, alone, or left out\n[apart]", FOR_SCENE },
    [MAX_DEPTH]  = { 0, "max-depth", "K", "a whole number from 1 to 255", "longest path in edges: 1 lights seen directly, 2 direct light ... [64]", FOR_SCENE },
    [BOOTSTRAP]  = { 0, "bootstrap", "N", "a whole number from 1 to 5e8",
                     "bidirectional samples for b and for the seeds of chains\n[100000 or more; with -t what pays; explain: 20000]", FOR_SCENE },
    [CHAINS]     = { 0, "chains", "N", "a whole number from 1 to 1e9", "chains, which share the mutations evenly [chosen by the program]", FOR_RENDER },
    [EXPOSURE]   = { 0, "exposure", "EV", "a number from -100 to 100", "for .ppm and .png: each 1 doubles the brightness [0]", FOR_RENDER | FOR_MERGE },
    [SAVE]       = { 0, "save", "FILE", "a file name", "write the run's state: every minute, at the end and on Ctrl-C", FOR_RENDER },
    [RESUME]     = { 0, "resume", "FILE", "a file name", "go on from a saved state; FILE may be that of --save", FOR_RENDER },
    [STATS]      = { 0, "stats", "FILE", "a file name", "counters as JSON; - is standard output", FOR_RENDER },
    [STRATEGY]   = { 0, "strategy", "NAME", "one of bidir, lens, caustic, chain, subpath, manifold", "explain: a mutation of this strategy [any]", FOR_EXPLAIN },
    [ACCEPTED]   = { 0, "accepted", NULL, NULL, "explain: one that is accepted", FOR_EXPLAIN },
    [LENGTH]     = { 0, "length", "K", "a whole number from 1 to 255", "explain: from a path of K edges [any]", FOR_EXPLAIN },
    [EXAMPLE]    = { 0, "example", "N", "1 or 2", "explain: a mutation of exactly the lecture's example 1 or 2", FOR_EXPLAIN },
    [AUDIT]      = { 0, "audit", NULL, NULL, "explain: test every strategy, or that of --strategy, on this scene", FOR_EXPLAIN },
    [QUIET]      = { 'q', "quiet", NULL, NULL, "no warnings, no progress", FOR_ALL },
    [VERBOSE]    = { 'v', "verbose", NULL, NULL, "a summary at the end", FOR_RENDER | FOR_MERGE },
    [HELP]       = { 'h', "help", NULL, NULL, "this text", FOR_ALL },
    [VERSION]    = { 0, "version", NULL, NULL, "the program's version", FOR_ALL },
};

/* A number from low to high that is all of the text. */
static bool read_real(const char *text, double low, double high, double *value)
{
    return parse_double(text, strlen(text), value) && *value >= low && *value <= high;
}

static bool read_above_0(const char *text, double high, double *value) { return read_real(text, 0, high, value) && *value > 0; }

static bool read_whole(const char *text, double low, double high, uint64_t *value)
{
    double real;
    if (!read_real(text, low, high, &real) || real != floor(real)) return false;
    *value = (uint64_t)real;
    return true;
}

static bool read_vector(const char *text, Vec3 *value)
{
    double v[3];
    for (int i = 0; i < 3; i++) {
        size_t n = strcspn(text, ",");
        if (!parse_double(text, n, &v[i]) || (text[n] == ',') != (i < 2)) return false;
        text += n + 1;
    }
    *value = vec3(v[0], v[1], v[2]);
    return true;
}

static bool read_size(const char *text, CameraSettings *camera)
{
    double width, height;
    size_t n = strcspn(text, "x");
    if (!parse_double(text, n, &width) || text[n] != 'x' || !read_real(text + n + 1, 1, SIDE_MAX, &height)) return false;
    camera->width = (uint32_t)fmin(fmax(width, 0), SIDE_MAX);
    camera->height = (uint32_t)height;
    return camera->width == width && camera->width > 0 && camera->height == height && width * height <= pixels_max;
}

/* Place of the text's first n characters among the words; -1 if they are none of them. */
static int find_word(const char *text, size_t n, int words, const char *const word[])
{
    for (int i = 0; i < words; i++)
        if (strlen(word[i]) == n && memcmp(word[i], text, n) == 0) return i;
    return -1;
}

static int find_strategy(const char *text, size_t n)
{
    const char *name[MUTATIONS];
    for (int i = 0; i < MUTATIONS; i++) name[i] = mutation_table[i].name;
    return find_word(text, n, MUTATIONS, name);
}

static bool read_strategies(const char *text, unsigned *strategies)
{
    for (*strategies = 0;; text++) {
        size_t n = strcspn(text, ",");
        int row = find_strategy(text, n);
        if (row < 0) return false;
        *strategies |= 1u << row;
        text += n;
        if (!*text) return true;
    }
}

static bool set_option(Options *o, OptionCode code, const char *value)
{
    static const char *const integrators[] = { "mlt", "bdpt", "path" }, *const directs[] = { "apart", "chain", "only", "none" };
    Settings *s = &o->settings;
    CameraSettings *c = &o->camera;
    uint64_t whole = 0;
    int word = 0;
    switch (code) {
    case OUTPUT: o->output[o->outputs++] = value; return image_format_known(value);
    case SIZE: return c->has_size = read_size(value, c);
    case EYE: return c->has_eye = read_vector(value, &c->eye);
    case LOOK: return c->has_look = read_vector(value, &c->look);
    case UP: return c->has_up = read_vector(value, &c->up) && (c->up.x != 0 || c->up.y != 0 || c->up.z != 0);
    case FOV: return c->has_fov = read_above_0(value, 180, &c->fov) && c->fov < 180;
    case APERTURE: return c->has_aperture = read_real(value, 0, INFINITY, &c->aperture);
    case FOCUS: return c->has_focus = read_above_0(value, INFINITY, &c->focus);
    case PER_PIXEL: return read_above_0(value, 1e10, &s->per_pixel);
    case TIME: return read_above_0(value, 1e9, &s->seconds);
    case ERROR: return read_above_0(value, INFINITY, &s->error);
    case SEED: return read_whole(value, 0, whole_max, &s->seed);
    case INTEGRATOR: word = find_word(value, strlen(value), 3, integrators); s->integrator = (Integrator)word; return word >= 0;
    case STRATEGIES: return read_strategies(value, &s->strategies);
    case DIRECT: word = find_word(value, strlen(value), 4, directs); s->direct = (DirectLight)word; return word >= 0;
    case MAX_DEPTH: if (!read_whole(value, 1, MAX_EDGES, &whole)) return false; s->max_depth = (int)whole; return true;
    case BOOTSTRAP: return read_whole(value, 1, 5e8, &s->bootstrap);
    case CHAINS: return read_whole(value, 1, 1e9, &s->chains);
    case EXPOSURE: return read_real(value, -100, 100, &o->exposure);
    case SAVE: o->save = value; return *value;
    case RESUME: o->resume = value; return *value;
    case STRATEGY: o->explain.strategy = value; return find_strategy(value, strlen(value)) >= 0;
    case ACCEPTED: return o->explain.accepted = true;
    case LENGTH: if (!read_whole(value, 1, MAX_EDGES, &whole)) return false; o->explain.length = (int)whole; return true;
    case EXAMPLE: if (!read_whole(value, 1, 2, &whole)) return false; o->explain.example = (int)whole; return true;
    case AUDIT: return o->explain.audit = true;
    case STATS: o->stats = value; return *value;
    case QUIET: o->verbosity = -1; return true;
    case VERBOSE: o->verbosity = 1; return true;
    case HELP: return o->help = true;
    case VERSION: return o->version = true;
    case OPTIONS: break;
    }
    return false;
}

/* The option called by a letter, or by the first n characters of a long name; OPTIONS if there is none. */
static OptionCode find_option(char letter, const char *name, size_t n)
{
    int i = 0;
    while (i < OPTIONS && !(name ? strlen(option_table[i].name) == n && memcmp(option_table[i].name, name, n) == 0 : option_table[i].letter == letter)) i++;
    return (OptionCode)i;
}

static bool option_for(OptionCode code, ForCommand command)
{
    return option_table[code].commands & (int)command;
}

typedef struct { int argc, next; char **argv; } Arguments;

/* Sets an option; attached is the value that came with it, or NULL: then it takes the next argument if it needs one. */
static bool take_option(Options *o, OptionCode code, const char *attached, Arguments *arguments, Report *report)
{
    const Option *option = &option_table[code];
    const char *value = attached;
    if (!option->argument && value) return report_error(report, NULL, 0, "--%s takes no value", option->name);
    if (option->argument && !value) {
        if (arguments->next >= arguments->argc) return report_error(report, NULL, 0, "--%s needs a value: %s", option->name, option->wanted);
        value = arguments->argv[arguments->next++];
    }
    return set_option(o, code, value) || report_error(report, NULL, 0, "--%s '%s': must be %s", option->name, value, option->wanted);
}

/* --name, --name=value, --name value, -l, -lvalue, -l value, and switches by one letter joined. False with an error. */
bool options_read(Options *o, ForCommand command, int argc, char **argv, const char **operand, int *operands, Report *report)
{
    Arguments a = { argc, 1, argv };
    bool ended = false;
    while (a.next < argc && !o->help && !o->version) {
        const char *arg = argv[a.next++];
        if (ended || arg[0] != '-' || !arg[1]) {
            operand[(*operands)++] = arg;
        } else if (strcmp(arg, "--") == 0) {
            ended = true;
        } else if (arg[1] == '-') {
            size_t n = strcspn(arg + 2, "=");
            OptionCode code = find_option(0, arg + 2, n);
            if (code == OPTIONS || !option_for(code, command)) return report_error(report, NULL, 0, "unknown option '%.*s'", (int)n + 2, arg);
            if (!take_option(o, code, arg[2 + n] ? arg + 3 + n : NULL, &a, report)) return false;
        } else for (const char *letter = arg + 1; *letter; letter++) {
            OptionCode code = find_option(*letter, NULL, 0);
            if (code == OPTIONS || !option_for(code, command)) return report_error(report, NULL, 0, "unknown option '-%c'", *letter);
            bool last = option_table[code].argument != NULL;
            if (!take_option(o, code, last && letter[1] ? letter + 1 : NULL, &a, report)) return false;
            if (last) break;
        }
    }
    if (o->help || o->version) return true;
    if (command != FOR_MERGE) {
        if (*operands == 0) return report_error(report, NULL, 0, "no scene given");
        if (*operands > 1) return report_error(report, NULL, 0, "one scene at a time, not '%s' and '%s'", operand[0], operand[1]);
        o->scene = operand[0];
    } else if (*operands == 0) return report_error(report, NULL, 0, "merge needs saved runs");
    else if (o->outputs == 0) return report_error(report, NULL, 0, "merge needs an output: -o FILE");
    Settings *s = &o->settings;
    const ExplainOptions *e = &o->explain;
    if (e->audit && (e->accepted || e->length || e->example))
        return report_error(report, NULL, 0, "--accepted, --length and --example choose a mutation to print: not with --audit");
    if (command == FOR_EXPLAIN && s->per_pixel > 0 && !e->audit) return report_error(report, NULL, 0, "explain takes -n only with --audit");
    o->explain.proposals = (uint64_t)ceil(s->per_pixel);     /* 0: its own default */
    if (s->per_pixel == 0 && s->seconds == 0 && s->error == 0) s->per_pixel = 256;
    return true;
}

/* Whether mutations are made; the references, and direct light alone, take independent samples. */
bool options_chains(const Settings *s) { return s->integrator == INTEGRATOR_MLT && s->direct != LIGHT_ONLY; }

/* What was asked for and will not be had. */
void options_warn(const Options *o, const Scene *scene, Report *report)
{
    const Settings *s = &o->settings;
    bool chains = options_chains(s), usable = false;
    if (scene->n_lights == 0) report_warning(report, o->scene, 0, "no light: no face emits (Ke); the picture will be black");
    if (!chains) {
        if (s->strategies != ALL_STRATEGIES || s->bootstrap || s->chains)
            report_warning(report, NULL, 0, "--strategies, --bootstrap and --chains mean nothing here: no chain runs");
        return;
    }
    for (int i = 0; i < MUTATIONS; i++) usable |= (s->strategies >> i & 1) && mutation_is_useful(&mutation_table[i], scene);
    if (!usable) report_warning(report, NULL, 0, "none of the strategies is of use in this scene: the picture shows the seeds alone");
    else if (!(s->strategies & 1u << find_strategy("bidir", 5)))
        report_warning(report, NULL, 0, "not ergodic: without 'bidir' a chain cannot reach all paths by itself; it still renders, from many seeds");
}

void options_help(void)
{
    for (int i = 0; i < OPTIONS; i++) {
        const Option *option = &option_table[i];
        const char letter[] = { '-', option->letter, ',', ' ', 0 }, *line = option->help;
        int at = printf("  %s--%s %s", option->letter ? letter : "    ", option->name, option->argument ? option->argument : "");
        for (; *line; at = 0) {
            int n = (int)strcspn(line, "\n");
            printf("%*s%.*s\n", 26 - at, "", n, line);
            line += n + (line[n] == '\n');
        }
    }
}
