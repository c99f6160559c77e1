/* The inside of a run, shared by render.c, which drives it, and state.c, which keeps it on file. Not for others. */
#ifndef RUN_H
#define RUN_H
#include "render.h"
#include "tracer.h"

enum { TILES_ACROSS = 8, TILE_PIXELS = 16 };   /* parts of the film: at most so many; not smaller than so many pixels */

/* How evenly the samples of each pixel fill it and the lamps: variance of a value over what samples that know nothing of each other would leave. It is
 * the product of two factors. */
enum { BRIGHTNESSES = 6 };         /* kinds of value, each four times as large as the last, from a sixteenth of the mean on */
typedef struct {
    double kind[BRIGHTNESSES], tile[TILES_ACROSS * TILES_ACROSS];
    double mean;                   /* of the samples' picture; 0 while nothing is known */
} Evenness;

/* On the whole integrand one pixel of so many has a bidirectional sample in a pass. */
enum { JOINED_STRIDE = 4 };

/* Independent samples, row by row. A pass is one sample of each pixel; once run_share_out has settled it, one on average. */
typedef struct {
    double *sum, *square;          /* [pixels][3] over the samples of each pixel */
    double *light, *light_square;  /* [pixels][3] what light subpaths bring to any pixel; only for bdpt, and for what run_spread moves */
    double *direct;                /* [pixels] over channels, what is direct light, but for what is spread: it may be large in one pixel alone, and is no outlier */
    double *first;                 /* [run_firsts] of pixels whose samples are two sequences: run_first */
    Evenness evenness;
    float *often;                  /* [pixels] samples in a pass since it was settled: a mean of 1 */
    float *cost;                   /* [pixels] rays for the samples of each pixel before that */
    double offset;                 /* in [0,1): where the pixels begin to count */
    uint64_t *count, *alike;       /* [height] passes over a row; of these, before it was settled */
    bool settled;
    double cut, cut_square;        /* over samples, of what the threshold took from them, a mean over channels */
    uint64_t rows;                 /* sampled so far; the pass is rows / height */
    uint64_t rays;
} Passes;

/* Paths that the independent samples of this round have met and, by their values, left to the chains, and that no bootstrap looks for: sums over samples
 * of their weights f* over the density of one sample, and of squares; and of their light by classes. */
enum { SEEDS = 256 };
typedef struct {
    double rows, rays;             /* rows of pixels sampled meanwhile */
    double hits, sum, square, now; /* now: of the sample under way */
    struct { double hits, weight, square, now; } found[CLASSES];
    Path *seed;                    /* [SEEDS], each drawn from all that were met in proportion to their weights */
} Met;

/* The round under way. Everything that is needed to go on with it after an interruption, but for the bootstrap, which replays. */
typedef struct {
    enum { PLAN, DIRECT, CHAINS } phase;
    double planned, chains;        /* steps, and how many chains share them */
    double chain, left;            /* the chain under way and the steps it has left; its state is Render.x */
    Rng rng;                       /* of that chain */
    uint64_t n_bootstrap;
    double steps, b, b_variance, met_variance;   /* done so far; of this round's seeds; of those that were met */
    double direct_deadline, chain_seconds, deadline;
} Round;

/* The chains' light in a part of the film, a mean over its values: over finished rounds the sums of steps * it and of steps * it^2, and the
 * largest steps * it of a round. */
typedef struct { double sum, square, largest; } Tile;

/* Who could have the easy part: a path tracer or a bidirectional one, and which of their walks are bent (+ BentWalks). */
typedef enum { TRACED, JOINED = BENDINGS, WAYS = 2 * BENDINGS } Way;
enum { CUTS = 19 };                /* tau that are weighed, the last ALL_KEPT */

/* What the survey has drawn. Sums of squares of values, or of what stands for them, and of their squares: */
typedef struct { double sum, square; } Moment;
/* What each tau would bring, summed over samples and relative to the picture: mean and second moment of the capped estimate, of one sample in its own pixel
 * and of each light path elsewhere. */
typedef struct {
    Rng rng;
    double n, rays, seconds;
    double mean[CUTS], own[CUTS];  /* own: of the sample under way */
    Moment moment[CUTS];
} Capped;
/* The same by bidirectional samples, path by path: the light that is left to the chains, of that the squares of what is met by chance alone (run_meet), how
 * many paths are above tau, and second moments. */
typedef struct {
    double n, indirect, left[CUTS], met[CUTS], above[CUTS];
    Moment moment[CUTS];
    Moment seeds[2][CUTS];         /* of what is left to the chains, to bidirectional samples whose walks are bent like the others; all */
} Told;
/* 'direct' is of a path tracer's direct light alone, 'joined' of bidirectional samples that have it too. */
typedef struct { Capped capped[WAYS], direct, joined; Told told[WAYS]; } Surveyed;

struct Render {
    const Scene *scene;
    const Settings *settings;
    size_t pixels;
    Space chain_space, direct_space, joined_space;   /* of the chains; of the path tracer; of the bidirectional path tracer */
    bool has_chain, has_direct;    /* any independent samples */
    bool bidirectional;            /* some of them are */
    bool direct_joined;            /* and have direct light, too, which else is the path tracer's */
    BentWalks bent, seeds_bent;    /* which of their walks are, and of a bootstrap's */
    bool catches;                  /* what can be joined nowhere is looked for by walks from the light, too */
    bool pilot;                    /* what is done now teaches, and is thrown away */
    Emission *emission;            /* learned after each round, for the seeds of the next; NULL without chains */
    Sampler sampler;
    Bdpt *bdpt;
    Path *x, *y, *trail;           /* of a chain; of the path tracer */
    Passes passes;
    Met met;
    /* chains: this round's splats, and over finished rounds the sum of steps * picture and of steps * picture^2 */
    Pixel *film;                   /* [pixels] */
    float *picture;                /* [pixels] the pilot's brightness, where no light of a few samples is left out */
    Image *early;                  /* the picture that the first pilot has made, until there is one of the divided integrand; else NULL */
    double *sum, *square;          /* [pixels][3] */
    double steps_sum, steps_square;/* over finished rounds: of steps, and of steps^2 */
    double apart_sum;              /* over finished rounds, of steps^2 * the square of what the halves of chains differ by, relative to the picture */
    double persistence;            /* of the chains' error, what both halves of all chains share: 1 where chains never get away from their seeds */
    double b_sum, b_variance_sum;  /* over rounds: of steps * b, and of steps^2 * variance of b */
    double met_variance_sum;       /* that part of it which does not come from bootstraps */
    Tile tile[TILES_ACROSS * TILES_ACROSS];
    Round round;
    uint64_t rounds, last_round;   /* begun so far; the number at which a run with a limit ends */
    double rate, samples_rate;     /* steps and bootstrap samples per second; guesses before the pilot */
    double direct_share;           /* rays of independent samples per ray of the chains */
    double start_share;            /* rays of the bootstrap per ray of the chains */
    double samples_per_step;       /* bootstrap samples that cost the rays of one step */
    double rays_per_step;          /* of the chains; 0 where they have found nothing */
    double half;                   /* 1 in the first half of a chain, -1 in the second */
    uint64_t more_pilots;          /* than usual */
    double seeds_before;           /* of the pilot before the last one */
    double seeds;                  /* worth a chain of their own, in the last round; 0 while unknown */
    double tau;                    /* thresholds are so many times the picture; 0 while the integrand is whole */
    Surveyed surveyed;
    double learned;                /* rays before the last run_learn */
    double whole_error, left;      /* of pilots: error times rays of the chains with the integrand whole; share of it that the first survey left to them */
    double relative_error;
    RenderStats stats;
    bool (*keep_going)(void *, const Render *);
    void *context;
    bool stopped;
};

/* Adds the chains of the round under way to those of finished rounds. */
void run_close_chains(Render *render);
/* One pixel in sixteen, others for each seed, has two sequences of samples, in turn: they tell how even one is. [3] is the sum over the first of them. */
static inline bool run_in_two(const Render *r, uint32_t x, uint32_t y) { return (x + 5 * y + (uint32_t)r->settings->seed) % 16 == 0; }
static inline size_t run_firsts(const Render *r) { return 3 * (size_t)r->scene->camera.height * (r->scene->camera.width / 16 + 1); }
static inline double *run_first(const Render *r, uint32_t x, uint32_t y) { return &r->passes.first[3 * ((size_t)y * (r->scene->camera.width / 16 + 1) + x / 16)]; }
/* Whether there is anything of the picture beside what the pilots have made: where the integrand is divided, both of its parts. */
static inline bool run_begun(const Render *r)
{
    return !r->has_chain || !r->has_direct || isinf(r->tau) || (!r->pilot && r->steps_sum + r->round.steps > 0);
}
/* Measures the evenness of independent samples. */
void run_evenness(Render *render);
/* The part of the film that a pixel (column, row) is in, and how many there are. */
uint32_t run_tile(const Render *render, uint32_t x, uint32_t y);
uint32_t run_tiles(const Render *render);
/* What is known of the light in each of them: means over its 'values', and the variances of those means. */
typedef struct { double mean, variance /* of the picture */, chain, chain_variance /* of the chains' part */, values; } TileLight;
void run_tile_light(const Render *render, TileLight light[]);
/* Independent samples of the pixels of the next row. False if memory runs out. */
bool run_sample_row(Render *render);
void run_forget_samples(Render *render);
/* Samples that a pixel of row y has had after so many passes. */
static inline uint64_t run_samples(const Passes *p, size_t pixel, uint32_t y, uint64_t passes)
{
    if (!p->settled || passes <= p->alike[y]) return passes;
    return p->alike[y] + (uint64_t)((double)(passes - p->alike[y]) * (double)p->often[pixel] + even(p->offset, pixel, 0));
}
/* Estimates the error of the picture, and from it the shares of work and the two-stage weight. */
void run_learn(Render *render);
/* After an earlier run's state was read: lets a run whose rounds are all done have more. */
void run_go_on(Render *render);
/* The chains' part of the relMSE against the pilot's picture, but for what is due to too few met seeds; to be called before the film's thresholds change. */
double run_chain_error(const Render *render);
/* Whether it is the whole integrand on which a pilot learns. */
static inline bool run_on_whole(const Render *render) { return render->pilot && render->has_direct && render->chain_space.part == WHOLE; }
/* Rays of independent samples per ray of the chains, at most: without a clock these are no measure of what the user asked for. */
static inline double run_most_share(const Render *render) { return render->settings->seconds > 0 ? 50 : 4; }
/* Divides the integrand at the thresholds: capped values to the path tracer, the rest to the chains. */
void run_divide(Render *render);
/* Of an indirect path that an independent sample is visiting, and that is not wholly the samples' own; it counts 'scale' times. */
void run_meet(Render *render, const Candidate *candidate, double scale, Rng *rng);
/* A walk from the light in search of more of those (bend_from_light): one pixel of RUN_CATCH_STRIDE has one in a pass, where Render.catches. */
enum { RUN_CATCH_STRIDE = 4 };
void run_catch(Render *render, Rng *rng);
/* After each sample: what it has met belongs together. */
void run_end_sample(Render *render);
/* b of what was met, *variance its variance; 0 where nothing was. */
double run_met(const Render *render, double *variance);
/* Sets x to one of the seeds, 0 <= u < 1 evenly over their weights. */
void run_met_seed(const Render *render, double u, Path *x);
void run_forget_met(Render *render);

/* Of a path that the path tracer is visiting, REACH_SEEN and not wholly of the space: brings what is left of it to the picture,
 * 'scale' times. False if memory runs out. */
bool run_spread(Render *render, const Candidate *candidate, double scale, Rng *rng);
/* Settles how often independent samples look at each pixel from now on: in proportion to passes.often, or to what the noise so far suggests. */
void run_settle(Render *render);
void run_share_out(Render *render);
/* Chooses the thresholds by what the pilot has left in them, the picture's own brightness, and the shares of work to begin with. */
void run_survey(Render *render);
#endif
