/* argv to file: the run and its progress, what it leaves, and the other commands.
 *
 * Whatever goes wrong comes here as a Report and leaves as one line on standard error: exit 1 for a scene or file, 2 for wrong usage.
 * Standard output holds only what was asked for. Must not know how a picture is computed. */
#include "options.h"
#include "output.h"
#include "stats.h"
#include <errno.h>
#include <inttypes.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <unistd.h>

enum { EXIT_USAGE = 2, SCREEN = 79, SAVE_SECONDS = 60 };
static const double pixels_max = 1 << 28;      /* what image_read takes */

/* ---- files ---- */

static void complain(const Report *report) { fprintf(stderr, "mlt: %s\n", report->error); }

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

static bool write_stats(const char *path, const Scene *scene, const RenderStats *stats, const Cost *cost, Report *report)
{
    if (strcmp(path, "-") == 0) {
        stats_write(stdout, scene, stats, cost);
        return (fflush(stdout) == 0 && !ferror(stdout)) || report_error(report, "standard output", 0, "cannot write: %s", strerror(errno));
    }
    Output out;
    if (!output_open(&out, path, report)) return false;
    stats_write(out.file, scene, stats, cost);
    return output_close(&out, path, true, report);
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
    const char *save;              /* NULL: nowhere */
    double saved;
    Report *report;
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
    at += snprintf(line + at, 40, "%.2f M %s/s", n / past / 1e6, options_chains(settings) ? "mutations" : "samples");
    if (isfinite(s->relative_error)) at += snprintf(line + at, 30, "   error %.2g %%", 100 * s->relative_error);
    left = ceil(left);
    if (left < 1e9) snprintf(line + at, 40, "   %.0f:%02.0f:%02.0f left", floor(left / 3600), floor(fmod(left / 60, 60)), floor(fmod(left, 60)));
    fprintf(stderr, "\r%-*.*s", SCREEN, SCREEN, line);
}

static bool keep_going(void *context, const Render *render)
{
    Watch *w = context;
    if ((!w->progress && !w->save) || stop) return !stop;
    double now = clock_now();
    if (w->save && now - w->saved >= SAVE_SECONDS) {
        if (!render_save(render, w->save, w->report)) report_warning(w->report, NULL, 0, "%s", w->report->error);
        w->saved = now;
    }
    if (w->progress && now - w->shown >= 0.2) {
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
    Watch watch = { &o->settings, (double)scene->camera.width * scene->camera.height, now, now, o->verbosity >= 0 && isatty(STDERR_FILENO),
                    o->save, now, report };
    struct sigaction action = { .sa_handler = on_signal, .sa_flags = SA_RESTART };
    sigaction(SIGINT, &action, NULL);
    sigaction(SIGTERM, &action, NULL);
    bool ok = !o->resume || render_resume(render, o->resume, report);
    if (!ok) {
        complain(report);
        return false;
    }
    ok = scene->n_lights == 0 || render_run(render, keep_going, &watch);
    if (watch.progress) fprintf(stderr, "\r%*s\r", SCREEN, "");
    if (!ok) {
        report_error(report, NULL, 0, "out of memory: the picture is not finished");
        complain(report);
    }
    if (o->save && !render_save(render, o->save, report)) {
        complain(report);
        ok = false;
    }
    RenderStats stats = render_stats(render);
    Cost cost = stats_cost(&o->settings, &stats);
    if (stats.bad_samples)
        report_warning(report, NULL, 0, "%" PRIu64 " samples were not finite and are left out: the picture may be too dark", stats.bad_samples);
    stats_warn(&stats, report);
    render_image(render, image);
    bool unseen = stats.mutations + stats.bootstrap_samples > 0 && stats.bootstrap_hits == 0;
    if (scene->n_lights > 0 && is_black(image))
        report_warning(report, o->scene, 0, "the picture is black: %s", unseen ? "the camera sees no light" : "so short a run has rendered nothing");
    else if (isinf(stats.tau)) report_warning(report, o->scene, 0, "the run was too short for the chains: all light is path traced");
    ok &= write_pictures(o, render, image, report);
    if (o->stats && !write_stats(o->stats, scene, &stats, &cost, report)) {
        complain(report);
        ok = false;
    }
    if (o->verbosity > 0) stats_print(stderr, o->scene, scene, &stats, &cost);
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
    for (int i = 0; ok && i < o->outputs; i++) ok = output_possible(o->output[i], report);
    if (ok && o->stats && strcmp(o->stats, "-") != 0) ok = output_possible(o->stats, report);
    if (ok && o->save) ok = output_possible(o->save, report) && (!output_special(o->save) || report_error(report, o->save, 0,
                            "a state takes the place of an older one, and needs a regular file"));
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
        options_warn(o, &scene, report);
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

static int print_version(void)
{
    puts("mlt 0.1.0");
    return printed();
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

/* Reads the arguments of a command and runs it on them. */
static int with_options(ForCommand command, int argc, char **argv, double start, bool (*run)(Options *, const char *const *operand, int operands, Report *))
{
    Options o = { .settings = { .direct = LIGHT_APART, .max_depth = 64, .strategies = ALL_STRATEGIES, .seed = 1, .start = start },
                  .output = malloc(((size_t)argc + 2) * sizeof *o.output) };
    const char **operand = malloc(((size_t)argc + 1) * sizeof *operand);
    int operands = 0, status = EXIT_FAILURE;
    Report report = { .error = "out of memory" };
    if (!o.output || !operand) complain(&report);
    else if (!options_read(&o, command, argc, argv, operand, &operands, &report)) status = usage_error(&report);
    else if (o.help) status = print_help();
    else if (o.version) status = print_version();
    else {
        report.warnings = o.verbosity >= 0 ? stderr : NULL;
        if (run(&o, operand, operands, &report)) status = EXIT_SUCCESS;
    }
    free(operand);
    free(o.output);
    return status;
}

static bool run_render(Options *o, const char *const *operand, int operands, Report *report)
{
    (void)operand;
    (void)operands;
    char *names = o->outputs == 0 ? default_outputs(o) : NULL;
    bool ok = o->outputs > 0 ? render_scene(o, report) : false;
    if (o->outputs == 0) complain(report);
    free(names);
    return ok;
}

static int command_render(int argc, char **argv, double start) { return with_options(FOR_RENDER, argc, argv, start, run_render); }

static bool run_explain(Options *o, const char *const *operand, int operands, Report *report)
{
    (void)operand;
    (void)operands;
    Scene scene;
    const Settings *s = &o->settings;
    bool ok = scene_load(&scene, o->scene, &o->camera, BVH_FAST, report);
    if (ok) {
        /* the space of the chains: without direct light if that is computed apart, as in a picture */
        DirectClass direct = s->direct == LIGHT_CHAIN ? DIRECT_INCLUDED : s->direct == LIGHT_ONLY ? DIRECT_ONLY : DIRECT_EXCLUDED;
        Space space = { .scene = &scene, .max_depth = s->max_depth, .direct = direct };
        Sampler sampler = sampler_for(&scene, s->strategies);
        o->explain.bootstrap = s->bootstrap;
        o->explain.seed = s->seed;
        ok = explain(&space, &sampler, &o->explain, stdout, report);
        scene_free(&scene);
    }
    if (!ok) complain(report);
    return printed() == EXIT_SUCCESS && ok;
}

static int command_explain(int argc, char **argv, double start) { return with_options(FOR_EXPLAIN, argc, argv, start, run_explain); }

static bool run_merge(Options *o, const char *const *operand, int operands, Report *report)
{
    bool ok = true;
    for (int i = 0; ok && i < o->outputs; i++) ok = output_possible(o->output[i], report);
    Render *merged = ok ? render_merge(operand, operands, report) : NULL;
    Image *image = merged ? image_new(render_width(merged), render_height(merged)) : NULL;
    if (image) {
        render_image(merged, image);
        ok = write_pictures(o, merged, image, report);
        RenderStats s = render_stats(merged);
        if (o->verbosity > 0)
            fprintf(stderr, "%d runs, %" PRIu64 " samples or mutations, estimated error %.3g %%\n", operands, s.mutations, 100 * s.relative_error);
    } else {
        if (merged) report_error(report, NULL, 0, "out of memory");
        complain(report);
        ok = false;
    }
    image_free(image);
    render_merged_free(merged);
    return ok;
}

static int command_merge(int argc, char **argv, double start) { return with_options(FOR_MERGE, argc, argv, start, run_merge); }

static int command_compare(int argc, char **argv, double start)
{
    (void)start;
    Report report = { .warnings = stderr };
    int first = argc > 1 && strcmp(argv[1], "--") == 0 ? 2 : 1;
    if (argc > 1 && (strcmp(argv[1], "--help") == 0 || strcmp(argv[1], "-h") == 0)) return print_help();
    if (argc > 1 && strcmp(argv[1], "--version") == 0) return print_version();
    for (int i = 1; first == 1 && i < argc; i++)
        if (argv[i][0] == '-' && !report_error(&report, NULL, 0, "unknown option '%s'", argv[i])) return usage_error(&report);
    if (argc - first != 2 && !report_error(&report, NULL, 0, "compare needs two pictures")) return usage_error(&report);
    const char *name_a = argv[first], *name_b = argv[first + 1];
    Image *a = image_read(name_a, &report), *b = a ? image_read(name_b, &report) : NULL;
    bool ok = a && b && ((a->width == b->width && a->height == b->height)
        || report_error(&report, name_a, 0, "is %ux%u, but %s is %ux%u", (unsigned)a->width, (unsigned)a->height, name_b, (unsigned)b->width,
                        (unsigned)b->height));
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
    { "merge", "-o OUT.pfm RUN...", "combine independent runs of one scene (see --save)", command_merge },
    { "explain", "[options] SCENE.obj", "one real mutation with every term of R(y|x) and a(y|x); --audit tests all", command_explain },
};
enum { COMMANDS = sizeof command_table / sizeof *command_table };

static int print_help(void)
{
    for (int i = 0; i < COMMANDS; i++) {
        const char *name = command_table[i].name;
        printf("%s mlt %s%s%-*s   %s\n", i ? "      " : "usage:", name, *name ? " " : "", 26 - (int)strlen(name), command_table[i].arguments,
               command_table[i].help);
    }
    puts("\nOptions, with their default in brackets; NAME.cam is the file beside SCENE.obj.");
    options_help();
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
