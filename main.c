/* argv to file: options, the run and its progress, pictures, counters as JSON, and the comparison of two pictures.
 *
 * Whatever goes wrong comes here as a Report and leaves as one line on standard error: exit 1 for a scene or file, 2 for wrong usage.
 * Standard output holds only what was asked for. Must not know how a picture is computed. */
#include "obj.h"
#include "render.h"
#include <errno.h>
#include <inttypes.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

enum { EXIT_USAGE = 2, SIDE_MAX = 65535, SCREEN = 79, ALL_STRATEGIES = (1 << MUTATIONS) - 1 };
static const double pixels_max = 1 << 28, whole_max = 0x1p53;    /* what image_read takes; what a double counts without gaps */

typedef struct {
    Settings settings;
    CameraSettings camera;
    const char *scene, *stats;     /* NULL if not given */
    const char **output;           /* [outputs], room for each argument and the two default names */
    int outputs, verbosity;        /* -1 quiet, 1 verbose */
    double exposure;
    bool help, version;
} Options;

/* ---- options ---- */

typedef enum { OUTPUT, SIZE, EYE, LOOK, UP, FOV, APERTURE, FOCUS, PER_PIXEL, TIME, ERROR, SEED, INTEGRATOR, STRATEGIES, DIRECT, MAX_DEPTH,
               BOOTSTRAP, CHAINS, EXPOSURE, STATS, QUIET, VERBOSE, HELP, VERSION, OPTIONS } OptionCode;

typedef struct {
    char letter;
    const char *name, *argument;   /* argument NULL: a switch */
    const char *wanted;            /* 'must be ...' */
    const char *help;
} Option;

static const Option option_table[OPTIONS] = {
    [OUTPUT]     = { 'o', "output", "FILE", "a name that ends in .pfm, .ppm or .png",
                     "image to write: .pfm linear float; .ppm and .png tone-mapped sRGB;\n.error.pfm the standard error of each value; may be repeated\n"
                     "[NAME.pfm and NAME.ppm in the current folder]" },
    [SIZE]       = { 's', "size", "WxH", "two whole numbers from 1 to 65535 with an x between, 2^28 pixels at most", "film size [NAME.cam, else 512x512]" },
    [EYE]        = { 0, "eye", "X,Y,Z", "three numbers with commas between", "where the camera stands [NAME.cam, else all of the scene is seen]" },
    [LOOK]       = { 0, "look", "X,Y,Z", "three numbers with commas between", "what it looks at" },
    [UP]         = { 0, "up", "X,Y,Z", "three numbers with commas between, not all 0", "what is up in the picture" },
    [FOV]        = { 0, "fov", "DEG", "a number between 0 and 180", "full vertical angle of view" },
    [APERTURE]   = { 0, "aperture", "R", "a number, 0 or more", "lens radius [NAME.cam, else 0: a pinhole]" },
    [FOCUS]      = { 0, "focus", "D", "a number above 0", "distance of the plane in focus [NAME.cam, else that of what is looked at]" },
    [PER_PIXEL]  = { 'n', "mutations", "N", "a number above 0, 1e10 at most", "mutations per pixel; samples per pixel for path and bdpt\n[256, or no limit with -t or -e]" },
    [TIME]       = { 't', "time", "SECONDS", "a number above 0, 1e9 at most", "stop after so long, loading included [no limit]" },
    [ERROR]      = { 'e', "error", "E", "a number above 0", "stop when the estimated relative error of the image is E or less" },
    [SEED]       = { 0, "seed", "N", "a whole number from 0 to 2^53", "same seed, scene, options and -n: same file, bit for bit [1]" },
    [INTEGRATOR] = { 0, "integrator", "NAME", "mlt, bdpt or path", "mlt, or one of the independent references bdpt and path [mlt]" },
    [STRATEGIES] = { 0, "strategies", "LIST", "a list of bidir, lens, caustic, chain, subpath with commas between",
                     "mutations to choose from: bidir,lens,caustic,chain,subpath\n[those that the scene can use]" },
    [DIRECT]     = { 0, "direct", "HOW", "apart, chain, only or none", "direct light: computed apart, left to the chain, alone, or left out\n[apart]" },
    [MAX_DEPTH]  = { 0, "max-depth", "K", "a whole number from 1 to 255", "longest path in edges: 1 lights seen directly, 2 direct light ... [64]" },
    [BOOTSTRAP]  = { 0, "bootstrap", "N", "a whole number from 1 to 5e8", "bidirectional samples for b and for the seeds of chains [100000]" },
    [CHAINS]     = { 0, "chains", "N", "a whole number from 1 to 1e9", "chains, which share the mutations evenly [chosen by the program]" },
    [EXPOSURE]   = { 0, "exposure", "EV", "a number from -100 to 100", "for .ppm and .png: each 1 doubles the brightness [0]" },
    [STATS]      = { 0, "stats", "FILE", "a file name", "counters as JSON; - is standard output" },
    [QUIET]      = { 'q', "quiet", NULL, NULL, "no warnings, no progress" },
    [VERBOSE]    = { 'v', "verbose", NULL, NULL, "a summary at the end" },
    [HELP]       = { 'h', "help", NULL, NULL, "this text" },
    [VERSION]    = { 0, "version", NULL, NULL, "the program's version" },
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
static bool read_options(Options *o, int argc, char **argv, Report *report)
{
    Arguments a = { argc, 1, argv };
    bool ended = false;
    while (a.next < argc && !o->help && !o->version) {
        const char *arg = argv[a.next++];
        if (ended || arg[0] != '-' || !arg[1]) {
            if (o->scene) return report_error(report, NULL, 0, "one scene at a time, not '%s' and '%s'", o->scene, arg);
            o->scene = arg;
        } else if (strcmp(arg, "--") == 0) {
            ended = true;
        } else if (arg[1] == '-') {
            size_t n = strcspn(arg + 2, "=");
            OptionCode code = find_option(0, arg + 2, n);
            if (code == OPTIONS) return report_error(report, NULL, 0, "unknown option '%.*s'", (int)n + 2, arg);
            if (!take_option(o, code, arg[2 + n] ? arg + 3 + n : NULL, &a, report)) return false;
        } else for (const char *letter = arg + 1; *letter; letter++) {
            OptionCode code = find_option(*letter, NULL, 0);
            if (code == OPTIONS) return report_error(report, NULL, 0, "unknown option '-%c'", *letter);
            bool last = option_table[code].argument != NULL;
            if (!take_option(o, code, last && letter[1] ? letter + 1 : NULL, &a, report)) return false;
            if (last) break;
        }
    }
    if (o->help || o->version) return true;
    if (!o->scene) return report_error(report, NULL, 0, "no scene given");
    Settings *s = &o->settings;
    if (s->per_pixel == 0 && s->seconds == 0 && s->error == 0) s->per_pixel = 256;
    return true;
}

/* Whether mutations are made; the references, and direct light alone, take independent samples. */
static bool has_chains(const Settings *s) { return s->integrator == INTEGRATOR_MLT && s->direct != LIGHT_ONLY; }

/* What was asked for and will not be had. */
static void warn_options(const Options *o, const Scene *scene, Report *report)
{
    const Settings *s = &o->settings;
    bool chains = has_chains(s), usable = false;
    if (scene->n_lights == 0) report_warning(report, o->scene, 0, "no light: no face emits (Ke); the picture will be black");
    if (!chains) {
        if (s->strategies != ALL_STRATEGIES || s->bootstrap || s->chains)
            report_warning(report, NULL, 0, "--strategies, --bootstrap and --chains mean nothing here: no chain runs");
        return;
    }
    for (int i = 0; i < MUTATIONS; i++) usable |= (s->strategies >> i & 1) && (scene->has_specular || !mutation_table[i].needs_specular);
    if (!usable) report_warning(report, NULL, 0, "none of the strategies is of use in this scene: the picture shows the seeds alone");
    else if (!(s->strategies & 1u << find_strategy("bidir", 5)))
        report_warning(report, NULL, 0, "not ergodic: without 'bidir' a chain cannot reach all paths by itself; it still renders, from many seeds");
    if (s->chains && s->per_pixel == 0) report_warning(report, NULL, 0, "--chains counts only with -n");
}

/* ---- files ---- */

static void complain(const Report *report) { fprintf(stderr, "mlt: %s\n", report->error); }

/* A pipe or a device: written to, never replaced by a file. */
static bool is_special(const char *path)
{
    struct stat s;
    return stat(path, &s) == 0 && !S_ISREG(s.st_mode) && !S_ISDIR(s.st_mode);
}

/* Opens a new file beside path, which is to be renamed when it is whole; its name is to be freed. NULL with errno set. */
static FILE *open_temporary(const char *path, char **name)
{
    size_t size = strlen(path) + 32;
    struct stat s;
    *name = malloc(size);
    if (stat(path, &s) == 0 && S_ISDIR(s.st_mode)) errno = EISDIR;
    else if (*name) {
        snprintf(*name, size, "%s.tmp%ld", path, (long)getpid());
        unlink(*name);
        return fopen(*name, "wx");
    }
    return NULL;
}

/* Asked before a long run: whether its result will have a place. */
static bool check_writable(const char *path, Report *report)
{
    if (is_special(path)) return true;
    char *name;
    FILE *file = open_temporary(path, &name);
    if (!file) report_error(report, path, 0, "cannot write: %s", strerror(errno));
    else {
        fclose(file);
        unlink(name);
    }
    free(name);
    return file;
}

static bool ends_in(const char *path, const char *ending)
{
    size_t n = strlen(path), m = strlen(ending);
    return n >= m && strcasecmp(path + n - m, ending) == 0;
}

/* All pictures that were asked for; one that cannot be written does not keep the others from it. */
static bool write_pictures(const Options *o, const Render *render, Image *image, Report *report)
{
    bool ok = true;
    for (int i = 0; i < o->outputs; i++) {
        if (ends_in(o->output[i], ".error.pfm")) render_error_image(render, image);
        else render_image(render, image);
        if (image_write(image, o->output[i], o->exposure, report)) continue;
        complain(report);
        ok = false;
    }
    return ok;
}

/* ---- counters ---- */

/* What a run has cost. Mutations, where no chain runs, are samples. */
typedef struct {
    bool chains;
    double seconds_total, peak_bytes, per_second, rays_each;
} Cost;

static Cost run_cost(const Settings *settings, const RenderStats *s)
{
    struct rusage usage;
    getrusage(RUSAGE_SELF, &usage);
    bool chains = has_chains(settings);
    double n = (double)s->mutations, seconds = chains ? s->seconds_chain : s->seconds_direct, rays = (double)(chains ? s->chain_rays : s->rays);
    return (Cost){ chains, clock_now() - settings->start, 1024.0 * (double)usage.ru_maxrss, seconds > 0 ? n / seconds : NAN, n > 0 ? rays / n : NAN };
}

static void write_json(FILE *file, const Scene *scene, const RenderStats *s, const Cost *cost)
{
    const struct { const char *key; double value; } entries[] = {
        { "seconds_load", scene->seconds_load }, { "seconds_build", scene->seconds_build }, { "seconds_start", s->seconds_start },
        { "seconds_direct", s->seconds_direct }, { "seconds_chain", s->seconds_chain }, { "seconds_total", cost->seconds_total },
        { "width", scene->camera.width }, { "height", scene->camera.height }, { "triangles", scene->mesh.n_triangles },
        { "mutations", (double)s->mutations }, { "mutations_per_second", cost->per_second },
        { "rays", (double)s->rays }, { "rays_per_mutation", cost->rays_each },
        { "b", cost->chains ? s->b : NAN }, { "b_stderr", cost->chains ? s->b_stderr : NAN }, { "estimated_relative_error", s->relative_error },
        { "bootstrap_samples", (double)s->bootstrap_samples }, { "bootstrap_hits", (double)s->bootstrap_hits },
        { "peak_bytes", cost->peak_bytes }, { "scene_bytes", (double)scene_bytes(scene) },
        { "bad_samples", (double)s->bad_samples }, { "longest_rejection_run", (double)s->chain.longest_rejection },
    };
    fputs("{\n", file);
    for (size_t i = 0; i < sizeof entries / sizeof *entries; i++) {
        double value = entries[i].value;
        if (isfinite(value)) fprintf(file, "  \"%s\": %.*g,\n", entries[i].key, value == floor(value) ? 17 : 9, value);
        else fprintf(file, "  \"%s\": null,\n", entries[i].key);
    }
    fputs("  \"strategies\": [", file);
    for (int i = 0; cost->chains && i < MUTATIONS; i++) {
        fprintf(file, "%s\n    {\"name\": \"%s\", \"proposed\": %" PRIu64 ", \"zero\": %" PRIu64 ", \"accepted\": %" PRIu64 ", \"zero_by\": {",
                i ? "," : "", mutation_table[i].name, s->chain.row[i].proposed, s->chain.row[i].zero, s->chain.row[i].accepted);
        for (int k = PROPOSED + 1; k < OUTCOMES; k++)
            fprintf(file, "%s\"%s\": %" PRIu64, k > PROPOSED + 1 ? ", " : "", outcome_name[k], s->chain.row[i].outcome[k]);
        fputs("}}", file);
    }
    fputs(cost->chains ? "\n  ]\n}\n" : "]\n}\n", file);
}

/* Whole or not at all, unless it goes to standard output or another place that cannot be replaced. */
static bool write_stats(const char *path, const Scene *scene, const RenderStats *stats, const Cost *cost, Report *report)
{
    bool printed = strcmp(path, "-") == 0, direct = printed || is_special(path);
    char *name = NULL;
    FILE *file = printed ? stdout : direct ? fopen(path, "w") : open_temporary(path, &name);
    if (file) write_json(file, scene, stats, cost);
    bool ok = file && fflush(file) == 0 && !ferror(file);
    if (file && !printed && fclose(file) != 0) ok = false;
    ok = ok && (direct || rename(name, path) == 0);
    if (!ok) report_error(report, printed ? "standard output" : path, 0, "cannot write: %s", strerror(errno));
    if (!ok && !direct && file) unlink(name);
    free(name);
    return ok;
}

static void print_summary(const Options *o, const Scene *scene, const RenderStats *s, const Cost *cost)
{
    fprintf(stderr, "%s: %u triangles, %u of them lights; film %ux%u\n", o->scene, (unsigned)scene->mesh.n_triangles, (unsigned)scene->n_lights,
            (unsigned)scene->camera.width, (unsigned)scene->camera.height);
    fprintf(stderr, "seconds: %.2f load, %.2f tree, %.2f start, %.2f %s, %.2f chains; %.2f in all; %.0f MB at most\n", scene->seconds_load, scene->seconds_build,
            s->seconds_start, s->seconds_direct, cost->chains ? "direct light" : "samples", s->seconds_chain, cost->seconds_total, cost->peak_bytes / 1e6);
    if (s->mutations == 0) return;
    fprintf(stderr, "%" PRIu64 " %s, %.3g a second, %.3g rays each; %" PRIu64 " rays\n", s->mutations, cost->chains ? "mutations" : "samples",
            cost->per_second, cost->rays_each, s->rays);
    if (cost->chains)
        fprintf(stderr, "b = %.6g +- %.2g from %" PRIu64 " samples, of which %" PRIu64 " found light; longest run of rejections %" PRIu64 "\n"
                "strategy     proposed      zero  accepted   zero because\n", s->b, s->b_stderr, s->bootstrap_samples, s->bootstrap_hits, s->chain.longest_rejection);
    for (int i = 0; i < MUTATIONS; i++) {
        double n = (double)s->chain.row[i].proposed, zero = (double)s->chain.row[i].zero;
        if (n == 0) continue;
        fprintf(stderr, "%-8s %12.0f %8.1f%% %8.1f%%  ", mutation_table[i].name, n, 100 * zero / n, 100 * (double)s->chain.row[i].accepted / n);
        for (int k = PROPOSED + 1; k < OUTCOMES; k++)
            if (s->chain.row[i].outcome[k]) fprintf(stderr, " %s %.0f%%", outcome_name[k], 100 * (double)s->chain.row[i].outcome[k] / zero);
        fputc('\n', stderr);
    }
    if (isnan(s->relative_error)) fputs("estimated error: not known, the run was too short\n", stderr);
    else fprintf(stderr, "estimated error: values are off by %.3g %% of their size (root mean square over the picture)\n", 100 * s->relative_error);
}

/* ---- the run ---- */

/* The one thing that changes outside of a run's own data: a handler can reach nothing else. */
static volatile sig_atomic_t stop;

/* The second signal finds the default action again. */
static void on_signal(int number)
{
    (void)number;
    stop = 1;
    signal(SIGINT, SIG_DFL);
    signal(SIGTERM, SIG_DFL);
}

typedef struct {
    const Settings *settings;
    double pixels, begun, shown;   /* seconds on the clock */
    bool progress;
} Watch;

/* Share done, speed, error, time left: that of the limit which will come first. */
static void show_progress(const Watch *w, const RenderStats *s, double now)
{
    const Settings *settings = w->settings;
    double past = now - w->begun, left = INFINITY, n = (double)s->mutations;
    if (settings->seconds > 0) left = fmax(0, settings->start + settings->seconds - now);
    if (settings->per_pixel > 0 && n > 0) left = fmin(left, fmax(0, past * (settings->per_pixel * w->pixels / n - 1)));
    if (settings->error > 0 && s->relative_error > 0)      /* the error falls as 1/sqrt(time); false for NAN */
        left = fmin(left, fmax(0, past * (pow(s->relative_error / settings->error, 2) - 1)));
    char line[SCREEN + 80] = "";
    int at = 0;
    if (isfinite(left)) at = snprintf(line, 20, "%3.0f %%   ", 100 * past / (past + left));
    at += snprintf(line + at, 40, "%.2f M %s/s", n / past / 1e6, has_chains(settings) ? "mutations" : "samples");
    if (isfinite(s->relative_error)) at += snprintf(line + at, 30, "   error %.2g %%", 100 * s->relative_error);
    left = ceil(left);
    if (left < 1e9) snprintf(line + at, 40, "   %.0f:%02.0f:%02.0f left", floor(left / 3600), floor(fmod(left / 60, 60)), floor(fmod(left, 60)));
    fprintf(stderr, "\r%-*.*s", SCREEN, SCREEN, line);
}

static bool keep_going(void *context, const Render *render)
{
    Watch *w = context;
    if (!w->progress || stop) return !stop;
    double now = clock_now();
    if (now - w->shown >= 0.2) {
        RenderStats s = render_stats(render);
        show_progress(w, &s, now);
        w->shown = now;
    }
    return true;
}

static bool is_black(const Image *image)
{
    size_t n = (size_t)image->width * image->height * 3, i = 0;
    while (i < n && image->rgb[i] == 0) i++;
    return i == n;
}

/* Renders and writes everything. A black scene is not run: no integrator has anything to start from. False if anything failed; it was said. */
static bool render_and_write(const Options *o, const Scene *scene, Render *render, Image *image, Report *report)
{
    double now = clock_now();
    Watch watch = { &o->settings, (double)scene->camera.width * scene->camera.height, now, now, o->verbosity >= 0 && isatty(STDERR_FILENO) };
    struct sigaction action = { .sa_handler = on_signal, .sa_flags = SA_RESTART };
    sigaction(SIGINT, &action, NULL);
    sigaction(SIGTERM, &action, NULL);
    bool ok = scene->n_lights == 0 || render_run(render, keep_going, &watch);
    if (watch.progress) fprintf(stderr, "\r%*s\r", SCREEN, "");
    if (!ok) {
        report_error(report, NULL, 0, "out of memory: the picture is not finished");
        complain(report);
    }
    RenderStats stats = render_stats(render);
    Cost cost = run_cost(&o->settings, &stats);
    if (stats.bad_samples) report_warning(report, NULL, 0, "%" PRIu64 " samples were not finite and are left out: the picture may be too dark", stats.bad_samples);
    render_image(render, image);
    bool unseen = stats.mutations + stats.bootstrap_samples > 0 && stats.bootstrap_hits == 0;
    if (scene->n_lights > 0 && is_black(image))
        report_warning(report, o->scene, 0, "the picture is black: %s", unseen ? "the camera sees no light" : "so short a run has rendered nothing");
    ok &= write_pictures(o, render, image, report);
    if (o->stats && !write_stats(o->stats, scene, &stats, &cost, report)) {
        complain(report);
        ok = false;
    }
    if (o->verbosity > 0) print_summary(o, scene, &stats, &cost);
    return ok;
}

/* A tree of high quality takes longer to build than a short run can gain from it. The film's size is not known yet. */
static BvhEffort build_effort(const Options *o)
{
    double pixels = o->camera.has_size ? (double)o->camera.width * o->camera.height : 512 * 512;
    bool is_short = (o->settings.seconds > 0 && o->settings.seconds < 2) || (o->settings.per_pixel > 0 && o->settings.per_pixel * pixels < 2e6);
    return is_short ? BVH_FAST : BVH_BEST;
}

static bool render_scene(const Options *o, Report *report)
{
    Scene scene;
    bool ok = true;
    for (int i = 0; ok && i < o->outputs; i++) ok = check_writable(o->output[i], report);
    if (ok && o->stats && strcmp(o->stats, "-") != 0) ok = check_writable(o->stats, report);
    if (!ok || !scene_load(&scene, o->scene, &o->camera, build_effort(o), report)) {
        complain(report);
        return false;
    }
    Image *image = NULL;
    Render *render = NULL;
    uint32_t width = scene.camera.width, height = scene.camera.height;
    if ((double)width * height > pixels_max) ok = report_error(report, o->scene, 0, "a film of %ux%u is too large", (unsigned)width, (unsigned)height);
    else if (!(image = image_new(width, height)) || !(render = render_new(&scene, &o->settings))) ok = report_error(report, NULL, 0, "out of memory");
    if (ok) {
        warn_options(o, &scene, report);
        ok = render_and_write(o, &scene, render, image, report);
    } else complain(report);
    render_free(render);
    image_free(image);
    scene_free(&scene);
    return ok;
}

/* ---- commands ---- */

static int print_help(void);

static int usage_error(const Report *report)
{
    complain(report);
    fputs("try 'mlt --help'\n", stderr);
    return EXIT_USAGE;
}

/* Exit status of a command whose result is what it printed. */
static int printed(void)
{
    if (fflush(stdout) == 0 && !ferror(stdout)) return EXIT_SUCCESS;
    fprintf(stderr, "mlt: standard output: cannot write: %s\n", strerror(errno));
    return EXIT_FAILURE;
}

/* NAME.pfm and NAME.ppm for a scene FOLDER/NAME.obj; the memory is the result, to be freed. NULL if there is none left. */
static char *default_outputs(Options *o)
{
    static const char ending[2][5] = { ".pfm", ".ppm" };
    const char *slash = strrchr(o->scene, '/'), *file = slash ? slash + 1 : o->scene, *dot = strrchr(file, '.');
    size_t n = dot && dot > file ? (size_t)(dot - file) : strlen(file);
    char *names = malloc(2 * (n + 5));
    for (size_t i = 0; names && i < 2; i++) {
        char *name = names + i * (n + 5);
        memcpy(name, file, n);
        memcpy(name + n, ending[i], 5);
        o->output[o->outputs++] = name;
    }
    return names;
}

static int command_render(int argc, char **argv, double start)
{
    Options o = { .settings = { .direct = LIGHT_APART, .max_depth = 64, .strategies = ALL_STRATEGIES, .seed = 1, .start = start },
                  .output = malloc(((size_t)argc + 2) * sizeof *o.output) };
    Report report = { .error = "out of memory" };
    char *names = NULL;
    int status = EXIT_FAILURE;
    if (!o.output) complain(&report);
    else if (!read_options(&o, argc, argv, &report)) status = usage_error(&report);
    else if (o.help) status = print_help();
    else if (o.version) { puts("mlt 0.1.0"); status = printed(); }
    else if (o.outputs == 0 && !(names = default_outputs(&o))) complain(&report);
    else {
        report.warnings = o.verbosity >= 0 ? stderr : NULL;
        if (render_scene(&o, &report)) status = EXIT_SUCCESS;
    }
    free(names);
    free(o.output);
    return status;
}

static int command_compare(int argc, char **argv, double start)
{
    (void)start;
    Report report = { .warnings = stderr };
    int first = argc > 1 && strcmp(argv[1], "--") == 0 ? 2 : 1;
    if (argc > 1 && (strcmp(argv[1], "--help") == 0 || strcmp(argv[1], "-h") == 0)) return print_help();
    for (int i = 1; first == 1 && i < argc; i++)
        if (argv[i][0] == '-' && !report_error(&report, NULL, 0, "unknown option '%s'", argv[i])) return usage_error(&report);
    if (argc - first != 2 && !report_error(&report, NULL, 0, "compare needs two pictures")) return usage_error(&report);
    const char *name_a = argv[first], *name_b = argv[first + 1];
    Image *a = image_read(name_a, &report), *b = a ? image_read(name_b, &report) : NULL;
    bool ok = a && b && ((a->width == b->width && a->height == b->height)
        || report_error(&report, name_a, 0, "is %ux%u, but %s is %ux%u", (unsigned)a->width, (unsigned)a->height, name_b, (unsigned)b->width, (unsigned)b->height));
    if (ok) {
        ImageError e = image_compare(a, b);
        const double value[] = { e.rmse, e.relmse, e.ratio_of_means };
        const char *const name[] = { "rmse", "relmse", "ratio_of_means" };
        for (int i = 0; i < 3; i++) printf("%s %.9g\n", name[i], isnan(value[i]) ? (double)NAN : value[i]);   /* 'nan', whatever its sign */
    } else complain(&report);
    image_free(a);
    image_free(b);
    return ok ? printed() : EXIT_FAILURE;
}

/* The first argument may name a command; rendering is what is done without. A command gets the arguments from its own name on. */
static const struct {
    const char *name, *arguments, *help;
    int (*run)(int argc, char **argv, double start);
} command_table[] = {
    { "", "[options] SCENE.obj", "render", command_render },
    { "compare", "A.pfm B.pfm", "error of A against the reference B: rmse, relmse, ratio of means", command_compare },
};
enum { COMMANDS = sizeof command_table / sizeof *command_table };

static int print_help(void)
{
    for (int i = 0; i < COMMANDS; i++) {
        const char *name = command_table[i].name;
        printf("%s mlt %s%s%-*s   %s\n", i ? "      " : "usage:", name, *name ? " " : "", 26 - (int)strlen(name), command_table[i].arguments, command_table[i].help);
    }
    puts("\nOptions, with their default in brackets; NAME.cam is the file beside SCENE.obj.");
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
    puts("\nExit status: 0 done, 1 the scene or a file cannot be used, 2 wrong usage. Ctrl-C stops the run and writes the image as it stands.");
    return printed();
}

int main(int argc, char **argv)
{
    double start = clock_now();
    for (int i = 1; i < COMMANDS && argc > 1; i++)
        if (strcmp(argv[1], command_table[i].name) == 0) return command_table[i].run(argc - 1, argv + 1, start);
    return command_table[0].run(argc, argv, start);
}
