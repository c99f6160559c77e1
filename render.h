/* A run: rounds of Metropolis chains beside direct light sampled apart, or passes of an independent reference; the picture, its estimated
 * error, and the run's state on file. Knows no options and no terminal. */
#ifndef RENDER_H
#define RENDER_H
#include "mlt.h"

typedef enum { INTEGRATOR_MLT, INTEGRATOR_BDPT, INTEGRATOR_PATH } Integrator;
typedef enum { LIGHT_APART, LIGHT_CHAIN, LIGHT_ONLY, LIGHT_NONE } DirectLight;   /* --direct apart, chain, only, none */

typedef struct {
    Integrator integrator;
    DirectLight direct;
    int max_depth;
    unsigned strategies;           /* bit i = row i of mutation_table */
    uint64_t seed;
    double per_pixel;              /* mutations (path, bdpt: samples) per pixel; 0 = no limit */
    double seconds;                /* wall clock since 'start'; 0 = no limit */
    double start;                  /* clock_now() when the program began */
    double error;                  /* stop at this estimated relative error; 0 = never */
    uint64_t bootstrap, chains;    /* totals over the run; 0 = the program chooses */
} Settings;

/* A cap above all values: independent samples have all light, and the chains none. */
#define ALL_KEPT 0x1p40

typedef struct {
    double seconds_start, seconds_direct, seconds_chain;
    uint64_t mutations;            /* for path and bdpt: samples */
    uint64_t rays, start_rays, chain_rays;   /* all; those of the bootstraps; of the chains */
    double b, b_stderr;
    double relative_error;         /* sqrt of the estimated relMSE of the picture; NAN while unknown */
    uint64_t bad_samples;
    uint64_t bootstrap_samples, bootstrap_hits;
    struct { uint64_t hits; double weight, square; } found[CLASSES];   /* samples that found such paths, for seeds; sums of their light and its squares */
    double tau;                    /* independent samples are worth so many times the picture at most; 0 while the integrand is whole, ALL_KEPT, INFINITY if the run is
                                      too short for chains */
    bool bidirectional;            /* those of indirect light are a bidirectional path tracer's */
    BentWalks bent;                /* which of their walks are bent through specular vertices (bend.h) */
    double chain_part;             /* of the picture's light, what the chains bring */
    /* Whether the rounds agree, tile by tile of the film; of finished rounds. */
    uint32_t tiles, rounds, tiles_disagreeing;  /* most of the chains' light, and enough to be seen, came in one round alone */
    double largest_tile_error;     /* standard error of a tile's mean, relative to it; NAN while unknown */
    double missed;                 /* of the picture's light, what the path tracer has met and the chains ought to have brought, and have not */
    double effective_samples;      /* of the chains: so many independent paths would spread as unevenly over tiles and rounds; NAN while unknown */
    ChainCount chain;
} RenderStats;

typedef struct Render Render;

/* NULL if memory runs out. The scene and settings must outlive it. */
Render *render_new(const Scene *scene, const Settings *settings);
void render_free(Render *render);

/* Works until a limit is reached or keep_going answers false; that is asked many times a second. Call once. False if memory runs out. */
bool render_run(Render *render, bool (*keep_going)(void *context, const Render *render), void *context);

RenderStats render_stats(const Render *render);

/* The picture as it stands, and the standard error of each value (0 while unknown); images of the film's size. */
void render_image(const Render *render, Image *image);
void render_error_image(const Render *render, Image *image);

/* Writes the run's state to a file, whole or not at all. Resuming goes on exactly where it stood: with the same seed and -n the picture is
 * that of an uninterrupted run. Files are for the machine and build that wrote them, and end in a checksum. A run that was done goes on if more is asked
 * for, in as many rounds again; that picture is not bit for bit the one of a single longer run. */
bool render_save(const Render *render, const char *path, Report *report);
/* Fills a fresh render from such a file. False with an error if it is damaged, or of another scene or other options (-n, -t, -e may differ). */
bool render_resume(Render *render, const char *path, Report *report);

/* Combines saved runs of one scene and one set of options with different seeds: pictures that carry their own b and their own cut of path space,
 * weighted by their work.
 * NULL with an error. Free with render_merged_free. */
Render *render_merge(const char *const *path, int n, Report *report);
void render_merged_free(Render *merged);
/* Film size of a render. */
uint32_t render_width(const Render *render);
uint32_t render_height(const Render *render);

/* Seconds on a clock that never goes back. */
double clock_now(void);
#endif
