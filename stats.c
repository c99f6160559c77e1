/* What a run says of itself. See stats.h. */
#include "stats.h"
#include "options.h"
#include <inttypes.h>
#include <sys/resource.h>

Cost stats_cost(const Settings *settings, const RenderStats *s)
{
    struct rusage usage;
    getrusage(RUSAGE_SELF, &usage);
    bool chains = options_chains(settings);
    double n = (double)s->mutations, seconds = chains ? s->seconds_chain : s->seconds_direct, rays = (double)(chains ? s->chain_rays : s->rays);
    return (Cost){ chains, clock_now() - settings->start, 1024.0 * (double)usage.ru_maxrss, seconds > 0 ? n / seconds : NAN, n > 0 ? rays / n : NAN };
}

/* Of the light that the chains have, as the samples found it that seeds are drawn from. */
static double class_share(const RenderStats *s, int class)
{
    double all = 0;
    for (int i = 0; i < CLASSES; i++) all += s->found[i].weight;
    return all > 0 ? s->found[class].weight / all : 0;
}

/* So many samples of equal light would tell as much: a few heavy ones may carry all. */
static double class_worth(const RenderStats *s, int class)
{
    return s->found[class].hits > 0 ? s->found[class].weight * s->found[class].weight / s->found[class].square : 0;
}

void stats_write(FILE *file, const Scene *scene, const RenderStats *s, const Cost *cost)
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
        { "tiles", s->tiles }, { "tiles_disagreeing", cost->chains ? (double)s->tiles_disagreeing : NAN }, { "largest_tile_error", s->largest_tile_error },
        { "effective_sample_size", cost->chains ? s->effective_samples : NAN }, { "chain_part", cost->chains ? s->chain_part : NAN },
        { "light_missed", cost->chains ? s->missed : NAN },
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
    fputs(cost->chains ? "\n  ],\n  \"classes\": [" : "],\n  \"classes\": [", file);
    for (int i = 0; cost->chains && i < CLASSES; i++)
        fprintf(file, "%s\n    {\"name\": \"%s\", \"hits\": %" PRIu64 ", \"share\": %.6g, \"worth\": %.4g}", i ? "," : "", path_class_name[i],
                s->found[i].hits, class_share(s, i), class_worth(s, i));
    fputs(cost->chains ? "\n  ]\n}\n" : "]\n}\n", file);
}

void stats_print(FILE *file, const char *name, const Scene *scene, const RenderStats *s, const Cost *cost)
{
    fprintf(file, "%s: %u triangles, %u of them lights; film %ux%u\n", name, (unsigned)scene->mesh.n_triangles, (unsigned)scene->n_lights,
            (unsigned)scene->camera.width, (unsigned)scene->camera.height);
    fprintf(file, "seconds: %.2f load, %.2f tree, %.2f start, %.2f samples, %.2f chains; %.2f in all; %.0f MB at most\n", scene->seconds_load, scene->seconds_build,
            s->seconds_start, s->seconds_direct, s->seconds_chain, cost->seconds_total, cost->peak_bytes / 1e6);
    if (s->mutations > 0) fprintf(file, "%" PRIu64 " %s, %.3g a second, %.3g rays each; %" PRIu64 " rays\n", s->mutations, cost->chains ? "mutations" : "samples",
            cost->per_second, cost->rays_each, s->rays);
    if (cost->chains && s->mutations > 0)
        fprintf(file, "b = %.6g +- %.2g from %" PRIu64 " samples, of which %" PRIu64 " found light; longest run of rejections %" PRIu64 "\n",
                s->b, s->b_stderr, s->bootstrap_samples, s->bootstrap_hits, s->chain.longest_rejection);
    if (cost->chains && s->tau > 0 && isfinite(s->tau)) {
        fprintf(file, "%s samples%s keep ", s->bidirectional ? "bidirectional" : "path tracer's", s->bent ? ", whose walks are bent to meet lamps," : "");
        if (s->tau == ALL_KEPT) fputs("all light, for they do better here than chains\n", file);
        else fprintf(file, "up to %g times the picture's own value; the chains bring %.2g %% of the light\n", s->tau, 100 * s->chain_part);
    }
    if (s->tiles_disagreeing == 0 && s->tiles > 0 && isfinite(s->effective_samples))
        fprintf(file, "rounds: %u agree in all of %u tiles, of which the worst is off by %.2g %%; the chains are worth %.3g independent paths\n",
                (unsigned)s->rounds, (unsigned)s->tiles, 100 * s->largest_tile_error, s->effective_samples);
    if (cost->chains && s->mutations > 0) fputs("strategy     proposed      zero  accepted   zero because\n", file);
    for (int i = 0; i < MUTATIONS; i++) {
        double n = (double)s->chain.row[i].proposed, zero = (double)s->chain.row[i].zero;
        if (n == 0) continue;
        fprintf(file, "%-8s %12.0f %8.1f%% %8.1f%%  ", mutation_table[i].name, n, 100 * zero / n, 100 * (double)s->chain.row[i].accepted / n);
        for (int k = PROPOSED + 1; k < OUTCOMES; k++)
            if (s->chain.row[i].outcome[k]) fprintf(file, " %s %.0f%%", outcome_name[k], 100 * (double)s->chain.row[i].outcome[k] / zero);
        fputc('\n', file);
    }
    if (isnan(s->relative_error)) fputs("estimated error: not known, the run was too short\n", file);
    else fprintf(file, "estimated error: values are off by %.3g %% of their size (root mean square over the picture)\n", 100 * s->relative_error);
}

void stats_warn(const RenderStats *s, Report *report)
{
    for (int i = 0; i < CLASSES; i++) {
        double share = class_share(s, i) * s->chain_part;
        if (share > 0.05 && class_worth(s, i) < 50)
            report_warning(report, NULL, 0, "%s: %.0f %% of the picture's light rest on some %.0f of %" PRIu64 " samples: "
                           "its brightness is not to be trusted", path_class_name[i], 100 * share, ceil(class_worth(s, i)), s->bootstrap_samples);
    }
    if (s->missed > 0.02)
        report_warning(report, NULL, 0, "some %.0f %% of the light are missing, where the picture is too dark: independent samples have met paths that the "
                       "chains have not found; run longer (-t)", 100 * s->missed / (1 + s->missed));
    double uncertain = s->b > 0 ? s->chain_part * s->b_stderr / s->b : 0;
    if (uncertain > 0.05)
        report_warning(report, NULL, 0, "the brightness of the chains' part, %.0f %% of the picture, is known to %.0f %% of it only: run longer (-t)",
                       100 * s->chain_part, 100 * s->b_stderr / s->b);
    if (s->tiles_disagreeing)
        report_warning(report, NULL, 0, "%u of %u tiles got most of their light in one round of %u: that light was found by chance "
                       "and may be too bright or too dim there; run longer (-t) or merge more seeds",
                       (unsigned)s->tiles_disagreeing, (unsigned)s->tiles, (unsigned)s->rounds);
}
