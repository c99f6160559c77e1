/* What a run says of itself: counters as JSON, a summary, and warnings of what its estimated error cannot know. */
#ifndef STATS_H
#define STATS_H
#include "render.h"

/* What a run has cost. Mutations, where no chain runs, are samples. */
typedef struct {
    bool chains;
    double seconds_total, peak_bytes, per_second, rays_each;
} Cost;

Cost stats_cost(const Settings *settings, const RenderStats *stats);
/* JSON, as --stats writes it. */
void stats_write(FILE *file, const Scene *scene, const RenderStats *stats, const Cost *cost);
/* For reading, as -v has it; 'name' is the scene's file. */
void stats_print(FILE *file, const char *name, const Scene *scene, const RenderStats *stats, const Cost *cost);
/* Light that was found by chance, so that what was found says little of what there is. */
void stats_warn(const RenderStats *stats, Report *report);
#endif
