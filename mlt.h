/* The Metropolis sampler: b and seeds from independent bidirectional samples, and the chain that walks the table of mutations.
 *
 *   N times { y = Mutate(x); a = AcceptProb(y|x); if Random() < a: x = y; RecordSample(image, x) }     [lecture: Large-scale structure of code]
 *
 * Knows no mutation by name and no image: what it records goes to a function. */
#ifndef MLT_H
#define MLT_H
#include "bdpt.h"
#include "mutate.h"

/* n bidirectional samples: b^ = mean of the weights W_i, seeds resampled from the same n in proportion to W_i. Then the expectation of
 * b^ * recorded is exact for every number of steps and every n; there is no start-up bias. */
typedef struct {
    uint64_t n, done;          /* samples, of them drawn so far */
    uint64_t seed, stream;     /* sample i replays from rng_new(seed, stream + i) */
    double *sum, square;       /* [n] running sum of W_i; sum of W_i^2 */
    double b, b_variance;      /* integral of f* over path space, and the variance of that estimate */
    uint64_t hits;             /* samples with W_i > 0 */
    double offset_x, offset_y; /* of the stratified raster positions */
    BentWalks bent;            /* which walks samples bend, if more than the space does; to be set after bootstrap_new */
    uint64_t bad;              /* samples that were not finite: dropped and reported */
    struct { uint64_t hits; double weight, square; } found[CLASSES];   /* by class of path: the samples that found one, sums of their light and light^2:
                                  the luminance, as far as the space holds it, without the weight w of the two-stage target */
} Bootstrap;

/* False if memory runs out. bootstrap_run does all at once; else bootstrap_sample draws at most so many more, until done is n. */
bool bootstrap_new(Bootstrap *bootstrap, uint64_t n, uint64_t seed, uint64_t stream);
void bootstrap_sample(Bootstrap *bootstrap, const Space *space, Bdpt *bdpt, uint64_t more);
bool bootstrap_run(Bootstrap *bootstrap, const Space *space, Bdpt *bdpt, uint64_t n, uint64_t seed, uint64_t stream);
void bootstrap_free(Bootstrap *bootstrap);
/* The path at u in [0,1) of the running sum. For many chains, take u stratified. False if b is 0. */
bool bootstrap_seed(const Bootstrap *bootstrap, const Space *space, Bdpt *bdpt, double u, Path *x);

/* A point of a sequence that fills [0,1)^9 evenly at every length, from an offset (additive recurrence); dimension 0 .. 8. */
static inline double even(double offset, uint64_t index, int dimension)
{
    /* Powers of 1/g, g the root of g^(d+1) = g + 1, the golden ratio's counterpart in d dimensions: five for place and light, which go together, two for
     * the way on, and two roots for the lens. */
    static const double step[9] = { 0.8812714616335696, 0.7766393890897682, 0.6844301295853426, 0.6031687406857282, 0.5315553977157688,
                                    0.7548776662466927, 0.5698402909980532, 0.4142135623730951, 0.7320508075688772 };
    double u = offset + step[dimension] * (double)(index & 0xffffffffu);
    return u - floor(u);
}

/* What a chain proposes from: rows, and how often. Among the rows that apply to x, row i is chosen with q_i(x) = share_i / sum of shares. */
typedef struct {
    const Mutation *table;
    int rows;
    double share[MUTATIONS];   /* 0: never proposed */
    Tuning tuning;
} Sampler;

/* The shares that a scene can use, of those that are allowed (bit i = row i of mutation_table), and the step sizes for a film. */
Sampler sampler_for(const Scene *scene, unsigned allowed);

typedef struct {
    uint64_t steps, bad, longest_rejection, rejection;   /* the last: the run of rejections that a chain is in; set it to 0 when a new one starts */
    struct { uint64_t proposed, accepted, zero, outcome[OUTCOMES]; } row[MUTATIONS];
} ChainCount;

/* Longer steps where nearly all that could be accepted were, shorter ones where few were: by a factor of 2, within a factor of 2 above and 8 below
 * the steps of sampler_for. For a pilot whose states are thrown away: a chain's own steps must not depend on its past. */
void sampler_tune(Sampler *sampler, const Scene *scene, const ChainCount *count);

/* Runs a chain of 'steps' mutations from x and leaves its last state there, so that it can go on; y is work space. Records every state with the
 * weights of expected values: their sum is 'steps'.
 * record(context, path, weight): the path's share of the picture is weight * colour / chi. */
void chain_run(const Space *space, const Sampler *sampler, Path *x, Path *y, uint64_t steps, Rng *rng,
               void (*record)(void *context, const Path *path, double weight), void *context, ChainCount *count);
#endif
