/* The picture as it stands, its estimated error, and whether the rounds have found the same light. See render.h.
 *
 * All of it is read from the accumulators of run.h; what is learned from it steers the rounds to come.
 */
#include "run.h"
#include <stdlib.h>
#include <string.h>

enum { LEAST_ROUNDS = 6 };         /* that can be said to agree or not */
static const double MOSTLY_KNOWN = 0.25;   /* variance of a value over its square, up to which its samples are said to be even */

/* A pixel of the picture by channels, and the variance of its values: of the part that independent samples bring, and of the chains' part, which is
 * known once two rounds are done. */
typedef struct { double value[3], chain[3] /* the chains' part of it */, sampled_variance[3], chain_variance[3]; } Estimate;

/* What is the same for all pixels; 0 where there is nothing of the kind. */
typedef struct {
    const Render *render;
    double light;                  /* the picture is light * (what light subpaths brought) */
    double per_step, round;        /* + per_step * sum + round * (this round's splats) */
    double per_closed_step, spread;/* variance of the chains' part: spread * (variance between finished rounds) */
} Estimator;

/* While the integrand is whole, bidirectional samples and chains both find all indirect light: of what the former find so large a share is taken, the
 * rest of the latter. */
static Estimator estimator_of(const Render *r, double joined_share)
{
    Estimator e = { .render = r };
    bool twice = run_on_whole(r);
    double steps = r->steps_sum + r->round.steps;
    if (steps == 0) joined_share = 1;
    double by_chains = twice ? 1 - joined_share : 1;
    if (r->passes.light && r->passes.rows > 0) e.light = (twice ? joined_share * JOINED_STRIDE : 1) * (double)r->scene->camera.height / (double)r->passes.rows;
    if (r->has_chain && steps > 0) {
        double share = r->steps_sum > 0 ? r->steps_square / (r->steps_sum * r->steps_sum) : 1;
        e.per_step = by_chains / steps;
        e.round = by_chains * r->round.b * (double)r->pixels / steps;
        if (share < 1) {
            e.per_closed_step = 1 / r->steps_sum;
            e.spread = by_chains * by_chains * share / (1 - share) * (r->steps_sum / steps);
        }
    }
    return e;
}

static Estimator estimator(const Render *r) { return estimator_of(r, 0.5); }

static inline double squared_and_floor(const Evenness *e, double value) { return value * value + 0.01 * e->mean * e->mean; }

static inline int brightness(const Evenness *e, double value)
{
    int kind = 0;
    for (double limit = e->mean / 16; kind < BRIGHTNESSES - 1 && value >= limit; limit *= 4) kind++;
    return kind;
}

/* What is rare falls where it likes. */
static inline double evenness(const Evenness *e, uint32_t tile, double value, double variance)
{
    bool fairly_known = e->mean > 0 && variance < MOSTLY_KNOWN * squared_and_floor(e, value);
    return fairly_known ? fmin(e->kind[brightness(e, value)] * e->tile[tile], 1) : 1;
}

/* The row whose samples stand for those of row y: on a large film a pilot has none of most rows. The nearest that has any, the upper one of two. */
static inline uint32_t sampled_row(const Render *r, uint32_t y)
{
    const uint64_t *count = r->passes.count;
    uint32_t height = r->scene->camera.height;
    for (uint32_t d = 0; r->pilot && d < height; d++) {
        if (d <= y && count[y - d] > 0) return y - d;
        if (y + d < height && count[y + d] > 0) return y + d;
    }
    return y;
}

static inline Estimate estimate(const Estimator *of, uint32_t x, uint32_t y)
{
    const Render *r = of->render;
    const Passes *p = &r->passes;
    size_t pixel = (size_t)y * r->scene->camera.width + x;
    Estimate e = { { 0 }, { 0 }, { 0 }, { 0 } };
    if (r->has_direct) {
        uint32_t row = sampled_row(r, y);
        size_t sampled = (size_t)row * r->scene->camera.width + x;
        double n = (double)run_samples(p, sampled, row, p->count[row]), inv_n = n > 0 ? 1 / n : 0, rest = n > 1 ? 1 / (n - 1) : 0;
        const double *sum = p->sum + 3 * sampled, *square = p->square + 3 * sampled;
        uint32_t tile = run_tile(r, x, y);
        for (int i = 0; i < 3; i++) {
            e.value[i] = sum[i] * inv_n;
            /* one sample is no more than a guess */
            double variance = n > 1 ? larger(0, square[i] * inv_n - e.value[i] * e.value[i]) * rest : square[i];
            e.sampled_variance[i] = variance * evenness(&p->evenness, tile, e.value[i], variance);
            if (of->light > 0) {
                e.value[i] += of->light * p->light[3 * pixel + (size_t)i];
                e.sampled_variance[i] += of->light * of->light * p->light_square[3 * pixel + (size_t)i];
            }
        }
    }
    if (of->per_step > 0) {
        const double *sum = r->sum + 3 * pixel, *square = r->square + 3 * pixel;
        for (int i = 0; i < 3; i++) {
            double mean = sum[i] * of->per_closed_step;
            e.chain[i] = of->per_step * sum[i] + of->round * r->film[pixel].sum[i];
            e.value[i] += e.chain[i];
            e.chain_variance[i] = larger(0, square[i] * of->per_closed_step - mean * mean) * of->spread;
        }
    }
    return e;
}

/* Of pixels that have two sequences of samples: by how much these differ, squared, over what chance would make of it, a weighted mean. */
typedef struct { double found, weight, squares; } Differences;

static void add_difference(Differences *d, double squared, double weight)
{
    d->found += weight * squared;
    d->weight += weight;
    d->squares += weight * weight;
}

/* That mean, as if so many pixels more had 'elsewhere'. The three values of a pixel err together. */
static double mean_difference(const Differences *d, double more, double elsewhere)
{
    double pixels = d->squares > 0 ? d->weight * d->weight / (3 * d->squares) : 0;
    return pixels > 0 ? (pixels * d->found / d->weight + more * elsewhere) / (pixels + more) : elsewhere;
}

/* A pixel's samples fill it, and the lamps, evenly, and so err less than the variance of one of them says, V = a V(1) / n. By how much, the pixels
 * tell that have two sequences: their means differ by no more than both err. One of all samples is more even than two of half as many: as n to some
 * power, which is 1 for one sample. Measured over values that are fairly known already. Where they are bright it is other light than where they are dark, and
 * what edges and lamps there are differs over the film. */
void run_evenness(Render *r)
{
    enum { MORE = 8, MORE_OF_KIND = 1, MORE_IN_TILE = 2 };       /* a few pixels cannot tell */
    Passes *p = &r->passes;
    Evenness *e = &p->evenness;
    Differences of_kind[BRIGHTNESSES] = { { 0 } }, of_tile[TILES_ACROSS * TILES_ACROSS] = { { 0 } }, of_all = { 0 };
    double logs = 0;                           /* weighted as of_all: of the samples of one sequence */
    uint32_t width = r->scene->camera.width, height = r->scene->camera.height;
    size_t pixel = 0;
    double light = 0, sampled = 0;
    for (uint32_t y = 0; y < height; y++)
        for (uint32_t x = 0; x < width; x++, pixel++) {
            double n = (double)run_samples(p, pixel, y, p->count[y]);
            if (n == 0) continue;
            for (int i = 0; i < 3; i++) light += p->sum[3 * pixel + (size_t)i] / n;
            sampled += 3;
        }
    e->mean = sampled > 0 ? light / sampled : 0;
    for (int in_tiles = 0; in_tiles < 2; in_tiles++) {
        pixel = 0;
        for (uint32_t y = 0; y < height; y++)
            for (uint32_t x = 0; x < width; x++, pixel++) {
                if (!run_in_two(r, x, y)) continue;
                double n = (double)run_samples(p, pixel, y, p->count[y]), n_first = ceil(n / 2), n_second = n - n_first;
                if (n_second < 2) continue;
                const double *sum = p->sum + 3 * pixel, *square = p->square + 3 * pixel, *first = run_first(r, x, y);
                for (int i = 0; i < 3; i++) {
                    double value = sum[i] / n, variance = larger(0, square[i] / n - value * value) / (n - 1), relative = variance / squared_and_floor(e, value);
                    double difference = first[i] / n_first - (sum[i] - first[i]) / n_second;
                    if (!(relative > 0 && relative < MOSTLY_KNOWN)) continue;
                    double squared = difference * difference * (n_first * n_second / (n * n)) / variance;
                    int kind = brightness(e, value);
                    if (in_tiles) add_difference(&of_tile[run_tile(r, x, y)], squared / e->kind[kind], sqrt(relative));
                    else {
                        add_difference(&of_all, squared, sqrt(relative));
                        logs += sqrt(relative) * log(n_second);
                        add_difference(&of_kind[kind], squared, sqrt(relative));
                    }
                }
            }
        if (in_tiles) for (uint32_t t = 0; t < run_tiles(r); t++) e->tile[t] = mean_difference(&of_tile[t], MORE_IN_TILE, 1);
        else for (int kind = 0; kind < BRIGHTNESSES; kind++) e->kind[kind] = mean_difference(&of_kind[kind], MORE_OF_KIND, mean_difference(&of_all, MORE, 1));
    }
    if (of_all.weight > 0) {
        double halves = logs / of_all.weight, power = (halves + log(2)) / halves;
        for (int kind = 0; kind < BRIGHTNESSES; kind++) e->kind[kind] = pow(e->kind[kind], power);
        for (uint32_t t = 0; t < run_tiles(r); t++) e->tile[t] = pow(e->tile[t], power);
    }
}

static float smaller_f(float a, float b) { return a < b ? a : b; }
static uint32_t smaller_u(uint32_t a, uint32_t b) { return a < b ? a : b; }
static float larger_f(float a, float b) { return a < b ? b : a; }

typedef float Combine(float, float, float, float, float);

static inline float median5(float a, float b, float c, float d, float e)
{
    float low = larger_f(smaller_f(a, b), smaller_f(c, d)), high = smaller_f(larger_f(a, b), larger_f(c, d));
    return larger_f(smaller_f(low, high), smaller_f(larger_f(low, high), e));   /* low, high: the middle two of four */
}

static inline float mean5(float a, float b, float c, float d, float e) { return (a + b + c + d + e) / 5; }

enum { STRIDE = 2 };               /* the longest between the pixels that a filter combines */

/* Along rows, then along columns: each value of a picture becomes combine(itself, two to the left and right that are 'stride' apart). 'work' has room
 * for the picture and for one row with 2 STRIDE more values at both ends. */
static inline void filter(float *picture, size_t width, size_t height, float *work, size_t stride, Combine *combine)
{
    size_t margin = 2 * stride;
    float *row = work + width * height;
    for (size_t y = 0; y < height; y++) {
        const float *from = picture + y * width;
        float *to = work + y * width;
        memcpy(row + margin, from, width * sizeof *row);
        for (size_t i = 0; i < margin; i++) {
            row[i] = from[0];
            row[margin + width + i] = from[width - 1];
        }
        for (size_t x = 0; x < width; x++) to[x] = combine(row[x], row[x + stride], row[x + 2 * stride], row[x + 3 * stride], row[x + 4 * stride]);
    }
    for (size_t y = 0; y < height; y++) {
        const float *in[5];
        float *to = picture + y * width;
        for (size_t i = 0; i < 5; i++) {
            size_t from = y + i * stride < margin ? 0 : y + i * stride - margin;
            in[i] = work + (from < height ? from : height - 1) * width;
        }
        for (size_t x = 0; x < width; x++) to[x] = combine(in[0][x], in[1][x], in[2][x], in[3][x], in[4][x]);
    }
}

/* Pixels along the side of a block in which chains have made some 8 mutations, and which has a row of samples. */
static size_t block_size(const Render *r)
{
    double steps = r->steps_sum + r->round.steps, rows = (double)r->passes.rows, chains = 1, samples = 1;
    if (r->has_chain && steps > 0) chains = ceil(sqrt(8 * (double)r->pixels / steps));
    if (r->pilot && rows > 0) samples = ceil(r->scene->camera.height / rows);
    return (size_t)fmin(fmax(chains, samples), 16);
}

/* The picture's brightness without its outliers, a mean over channels: the median of the surroundings, or, for small features, the mean of so much of
 * nearby values as lies above their standard errors. By a plain mean one firefly would starve its surroundings of chains and so beget
 * others. While chains have left little in a pixel, all that by blocks: a median over mostly empty pixels would be none. *mean receives that of
 * the picture. False if memory runs out. */
static bool typical_brightness(const Render *r, const Estimator *all, float *out, float *plain, double *mean)
{
    size_t width = r->scene->camera.width, height = r->scene->camera.height, block = block_size(r);
    size_t across = (width + block - 1) / block, down = (height + block - 1) / block, blocks = across * down;
    float *bright = calloc(blocks, sizeof *bright), *safe = calloc(blocks, sizeof *safe), *work = malloc((blocks + across + 4 * STRIDE) * sizeof *work);
    bool ok = bright && safe && work;
    *mean = 0;
    if (ok) {
        for (uint32_t y = 0; y < height; y++)
            for (uint32_t x = 0; x < width; x++) {
                Estimate e = estimate(all, x, y);
                size_t at = y / block * across + x / block;
                double value = 0, error = 0;
                for (int i = 0; i < 3; i++) {
                    value += e.value[i] / 3;
                    error += sqrt(e.sampled_variance[i] + e.chain_variance[i]) / 3;
                }
                *mean += value / (double)r->pixels;
                bright[at] += (float)value;
                safe[at] += (float)(error * error);
            }
        for (size_t y = 0; y < down; y++)
            for (size_t x = 0; x < across; x++) {
                size_t at = y * across + x, columns = x + 1 < across ? block : width - x * block, rows = y + 1 < down ? block : height - y * block;
                float n = (float)(columns * rows);
                safe[at] = larger_f(0, bright[at] - sqrtf(safe[at])) / n;
                bright[at] /= n;
            }
        if (plain) {
            memcpy(plain, bright, blocks * sizeof *plain);
            filter(plain, across, down, work, 1, mean5);
            for (size_t i = r->pixels; i-- > 0;)       /* backwards: none is read after it is written over */
                plain[i] = plain[i / width / block * across + i % width / block];
        }
        filter(bright, across, down, work, STRIDE, median5);
        filter(safe, across, down, work, 1, mean5);
        for (size_t y = 0; y < height; y++)
            for (size_t x = 0; x < width; x++) {
                size_t at = y / block * across + x / block;
                *out++ = larger_f(bright[at], safe[at]);
            }
    }
    free(bright);
    free(safe);
    free(work);
    return ok;
}

/* What the value may be, to divide its error by. Variances are largest where values came out too large by chance: divided by the values themselves
 * the error would come out too small. So a value differs from its surroundings only by so much as its standard error does not explain
 * (James and Stein's rule for one value); nothing is left of a firefly, whose standard error is as large as itself. Nor is a value ever as large as itself:
 * where n parcels of light are due, as many as come are 1 / n off, and of n that came, n / (n - 1/3)^2 is that on average (from one due on). */
static double likely_value(double value, double variance, double typical)
{
    double difference = value - typical, squared = difference * difference;
    double likely = squared > variance ? value - difference * (variance / squared) : typical;
    return value > 0 ? fmin(likely, value - variance / (3 * value)) : likely;
}

/* What to expect of a pixel's values: what is typical, unless there is far more direct light. A lamp, or its image, may be seen in one pixel alone and
 * fill so little of that one that its samples look like outliers; but direct light has none. */
static double surroundings(const Render *r, size_t pixel, uint32_t y, double typical)
{
    double n = r->has_direct ? (double)r->passes.count[y] : 0, direct = n > 0 ? r->passes.direct[pixel] / (3 * n) : 0;
    return direct > 4 * typical ? direct : typical;
}

static uint32_t tiles_along(uint32_t pixels) { return smaller_u(TILES_ACROSS, pixels < 2 * TILE_PIXELS ? 1 : pixels / TILE_PIXELS); }

uint32_t run_tiles(const Render *r) { return tiles_along(r->scene->camera.width) * tiles_along(r->scene->camera.height); }

uint32_t run_tile(const Render *r, uint32_t x, uint32_t y)
{
    uint32_t width = r->scene->camera.width, height = r->scene->camera.height, across = tiles_along(width);
    return y * tiles_along(height) / height * across + x * across / width;
}

/* Of the picture's light, what the path tracer met and left to the chains, and they do not have, if the errors of both do not explain it. What is found
 * too rarely for a bootstrap may still be found by the path tracer's far more samples. */
static double missed(const Render *r, double chain, double mean)
{
    double n = (double)r->passes.rows * r->scene->camera.width, b = r->stats.b;
    if (!(n > 0) || r->chain_space.part == WHOLE) return 0;
    double cut = r->passes.cut / n, own = b > 0 ? chain * sqrt(r->b_variance_sum) / r->b_sum : 0;
    double error = sqrt(r->passes.cut_square / (n * n) + own * own);
    return cut - chain > 2.5 * error ? (cut - chain) / mean : 0;
}

/* So many rounds of equal length would tell as much. */
static double rounds_of(const Render *r) { return r->steps_square > 0 ? r->steps_sum * r->steps_sum / r->steps_square : 0; }

void run_tile_light(const Render *r, TileLight light[])
{
    uint32_t tiles = run_tiles(r);
    double rounds = rounds_of(r);
    Estimator all = estimator(r);
    memset(light, 0, tiles * sizeof *light);
    for (uint32_t y = 0; y < r->scene->camera.height; y++)
        for (uint32_t x = 0; x < r->scene->camera.width; x++) {
            TileLight *l = &light[run_tile(r, x, y)];
            Estimate e = estimate(&all, x, y);
            double error = 0;
            for (int i = 0; i < 3; i++) {
                l->mean += e.value[i];
                error += sqrt(e.sampled_variance[i]);     /* channels err together, pixels apart */
            }
            l->variance += error * error;
            l->values += 3;
        }
    for (uint32_t t = 0; t < tiles; t++) {
        TileLight *l = &light[t];
        const Tile *tile = &r->tile[t];
        l->mean /= l->values;
        l->chain = rounds > 0 ? tile->sum / r->steps_sum : 0;
        l->chain_variance = rounds > 1 ? fmax(0, tile->square / r->steps_sum - l->chain * l->chain) / (rounds - 1) : 0;
        l->variance = l->variance / (l->values * l->values) + l->chain_variance;
    }
}

/* Whether the rounds have found the same light. Pixels cannot tell: in most of them a round leaves little. In a tile where one round has brought more
 * than all others together, it has come upon paths that the others have missed, or one of its chains has been caught; how much of that light
 * there ought to be is then known to no one, and the spread between rounds does not tell it. 'mean' is that of the picture. */
static void learn_agreement(Render *r, double mean)
{
    TileLight light[TILES_ACROSS * TILES_ACROSS];
    double rounds = rounds_of(r), energy = 0, unevenness = 0;
    RenderStats *s = &r->stats;
    s->tiles = run_tiles(r);
    s->tiles_disagreeing = 0;
    s->largest_tile_error = 0;
    run_tile_light(r, light);
    for (uint32_t t = 0; t < s->tiles; t++) {
        const Tile *tile = &r->tile[t];
        const TileLight *l = &light[t];
        energy += l->values * l->chain;
        unevenness += l->values * l->values * l->chain_variance;
        s->largest_tile_error = fmax(s->largest_tile_error, sqrt(l->variance / (l->mean * l->mean + 0.01 * mean * mean)));
        if (rounds < LEAST_ROUNDS) continue;
        double others = (tile->sum - tile->largest) / r->steps_sum * (rounds / (rounds - 1));
        s->tiles_disagreeing += tile->largest > 0.5 * tile->sum && l->chain - others > 0.1 * l->mean + 0.01 * mean;
    }
    s->chain_part = energy / (3 * (double)r->pixels * mean);
    s->missed = missed(r, s->chain_part * mean, mean);
    s->rounds = (uint32_t)(rounds + 0.5);
    if (r->has_chain && rounds < LEAST_ROUNDS) s->largest_tile_error = NAN;
    s->effective_samples = rounds < LEAST_ROUNDS ? NAN : energy * energy / unevenness;
}

/* The error of two kinds of work falls as 1/rays in each; together it is least where rays go as sqrt(error * rays). */
static double best_share(double error, uint64_t rays, double other_error, uint64_t other_rays, double least, double most)
{
    double share = sqrt(error * (double)rays / (other_error * (double)other_rays));
    return share > least ? fmin(share, most) : least;  /* NaN too */
}

/* Of a pilot on the whole integrand the brighter of what chains and bidirectional samples say: each may have missed what the other finds, and outliers
 * are left out. 'plain' has room for another picture behind it, or is NULL. */
static bool learn_brightness(const Render *r, float *local, float *plain, double *mean)
{
    Estimator by_chains = estimator_of(r, 0), by_samples = estimator_of(r, 1);
    if (!typical_brightness(r, &by_chains, local, plain, mean)) return false;
    if (!plain) return true;
    float *other = plain + r->pixels;
    double other_mean;
    if (!typical_brightness(r, &by_samples, other, NULL, &other_mean)) return false;
    for (size_t i = 0; i < r->pixels; i++) local[i] = larger_f(local[i], other[i]);
    if (!(*mean > 0)) *mean = other_mean;
    return true;
}

/* Medians of noisy values are less than their means. By how much, over the picture, each pixel weighing as in relMSE, and but for what sticks out of it. */
static double lift(const Estimator *all, const float *typical, double mean)
{
    const Camera *c = &all->render->scene->camera;
    double values = 0, medians = 0;
    for (uint32_t y = 0; y < c->height; y++)
        for (uint32_t x = 0; x < c->width; x++, typical++) {
            Estimate e = estimate(all, x, y);
            double median = (double)*typical, weight = 1 / (median + 0.1 * mean);
            values += weight * fmin((e.value[0] + e.value[1] + e.value[2]) / 3, 8 * median);
            medians += weight * median;
        }
    return medians > 0 ? fmax(values / medians, 1) : 1;
}

/* After a round: the estimated relMSE, the shares of rays that direct light and bootstrap should have, and the two-stage weight. */
void run_learn(Render *r)
{
    bool pilot = run_on_whole(r);              /* whose picture the survey needs */
    float *local = malloc((pilot ? 3 : 1) * r->pixels * sizeof *local), *plain = local && pilot ? local + r->pixels : NULL;
    double mean, sampled = 0, chain = 0, chain_energy = 0;   /* the last three relative to the picture, summed over values */
    double chain_by_weight = 0;                /* summed over pixels, by the weights that the rounds had */
    r->learned = (double)*r->scene->rays;
    if (r->passes.first) run_evenness(r);
    if (!local || !learn_brightness(r, local, plain, &mean)) {    /* goes on with what it knew */
        free(local);
        return;
    }
    if (mean > 0) {
        Estimator all = estimator(r);
        double lifted = lift(&all, local, mean);
        size_t pixel = 0;
        for (uint32_t y = 0; y < r->scene->camera.height; y++)
            for (uint32_t x = 0; x < r->scene->camera.width; x++, pixel++) {
                Estimate e = estimate(&all, x, y);
                double typical = (double)local[pixel], around = surroundings(r, pixel, y, lifted * typical);
                for (int i = 0; i < 3; i++) {
                    double likely = likely_value(e.value[i], e.sampled_variance[i] + e.chain_variance[i], around);
                    double inverse = 1 / (likely * likely + 0.01 * mean * mean);
                    sampled += e.sampled_variance[i] * inverse;
                    chain += e.chain_variance[i] * inverse;
                    chain_energy += e.chain[i] * e.chain[i] * inverse;
                }
                Rgb error = { sqrt(e.chain_variance[0]), sqrt(e.chain_variance[1]), sqrt(e.chain_variance[2]) };
                if (r->has_chain) chain_by_weight += pow((double)r->film[pixel].weight * luminance(error), 2);
                /* pixels in proportion to their relative error: w ~ 1/picture, floored so that none starves */
                if (r->has_chain) r->film[pixel].weight = (float)(mean / (typical + 0.05 * mean));
                if (pilot) {
                    r->film[pixel].threshold = (float)(typical + 0.05 * mean);   /* survey scales it */
                    r->picture[pixel] = larger_f(local[pixel], plain[pixel]) + (float)(0.05 * mean);
                }
            }
        double values = 3 * (double)r->pixels;
        bool sampled_twice = !r->has_direct || r->passes.rows >= 2 * (uint64_t)r->scene->camera.height;
        bool known = !r->has_chain || r->stats.b == 0 || r->steps_square < r->steps_sum * r->steps_sum;
        r->relative_error = known && sampled_twice ? sqrt((sampled + chain) / values) : NAN;
        if (known && r->has_chain && r->stats.b > 0) {
            uint64_t chain_rays = r->stats.chain_rays + r->stats.start_rays;
            /* what the uncertain b alone contributes, of the seeds that samples have met and of bootstraps */
            double per_variance = chain_energy / (r->b_sum * r->b_sum), by_met = r->met_variance_sum * per_variance, by_b = r->b_variance_sum * per_variance - by_met;
            double others = fmax(chain - by_met, 0.1 * chain);
            if (r->has_direct && !pilot) r->direct_share = best_share(sampled + by_met, r->passes.rays, others, chain_rays, 0.02, run_most_share(r));
            /* the variance of the halves' difference against that of their sum: 0 where both are alike; by the chains' share of the picture, as chain_variance is */
            double apart = pow(all.per_step * (r->steps_sum + r->round.steps) / r->steps_sum, 2) * r->apart_sum;
            if (chain_by_weight > 0) r->persistence = fmin(fmax(1 - apart / chain_by_weight, 0), 1);
            /* but b is not all: of few bootstrap samples a heavy one begins so many chains that its pixel is too bright */
            r->start_share = best_share(by_b, r->stats.start_rays, fmax(chain - by_b, 0.1 * chain), r->stats.chain_rays, 0.05, 2);
        }
        learn_agreement(r, mean);
    } else if (!r->has_chain || r->stats.bootstrap_hits == 0) r->relative_error = 0;     /* black, and nothing says that it should not be */
    free(local);
}

void run_settle(Render *r)
{
    Passes *p = &r->passes;
    double sum = 0;
    for (size_t i = 0; i < r->pixels; i++) sum += (double)p->often[i];
    for (size_t i = 0; i < r->pixels; i++) p->often[i] *= (float)((double)r->pixels / sum);
    Rng rng = rng_new(r->settings->seed, (uint64_t)4 << 61);
    p->offset = rng_double(&rng);
    memcpy(p->alike, p->count, r->scene->camera.height * sizeof *p->alike);
    p->settled = true;
}

/* Where a sample's error is larger, relative to the picture, more of them: as its root, so that the sum of errors is least for the work. It is told by the
 * pixels around: they have had few samples each, and the pixel's own are to have no part in it (passes.c), not by way of the picture either, which is the
 * pilot's beside what each of those others has brought itself. */
void run_share_out(Render *r)
{
    enum { RADIUS = 4, MOST = 8 };
    Passes *p = &r->passes;
    int width = (int)r->scene->camera.width, height = (int)r->scene->camera.height;
    float *noise = malloc(r->pixels * sizeof *noise);      /* like the cost, a sum over the samples of a pixel */
    double mean = 0, sum = 0;
    if (!noise) return;                        /* goes on as it is */
    for (size_t i = 0; i < r->pixels; i++) mean += (double)r->film[i].threshold / (r->tau * (double)r->pixels);
    for (size_t pixel = 0; pixel < r->pixels; pixel++) {
        double n = (double)p->count[pixel / (size_t)width], typical = (double)r->film[pixel].threshold / r->tau;
        noise[pixel] = 0;
        for (size_t i = 3 * pixel; i < 3 * pixel + 3; i++) {
            double value = p->sum[i] / n, variance = larger(0, p->square[i] / n - value * value), likely = likely_value(value, variance / n, typical);
            noise[pixel] += (float)(n * variance / (likely * likely + 0.01 * mean * mean));
        }
    }
    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++) {
            double around = 0, cost = 0;
            for (int v = y < RADIUS ? 0 : y - RADIUS; v <= y + RADIUS && v < height; v++)
                for (int u = x < RADIUS ? 0 : x - RADIUS; u <= x + RADIUS && u < width; u++) {
                    if (u == x && v == y) continue;
                    around += (double)noise[v * width + u];
                    cost += (double)p->cost[v * width + u];
                }
            sum += (double)(p->often[y * width + x] = (float)(cost > 0 ? sqrt(around / cost) : 1));
        }
    double average = sum / (double)r->pixels;
    for (size_t i = 0; i < r->pixels; i++) {
        double relative = average > 0 ? (double)p->often[i] / average : 1;
        p->often[i] = (float)fmin(sqrt(relative * relative + 0.1), MOST);
    }
    run_settle(r);
    free(noise);
}

double run_chain_error(const Render *r)
{
    Estimator all = estimator_of(r, 0);
    double relative_met = r->met_variance_sum / (r->b_sum * r->b_sum), sum = 0, by_met = 0;
    size_t pixel = 0;
    for (uint32_t y = 0; y < r->scene->camera.height; y++)
        for (uint32_t x = 0; x < r->scene->camera.width; x++, pixel++) {
            Estimate e = estimate(&all, x, y);
            double picture = (double)r->picture[pixel];
            for (int i = 0; i < 3; i++) {
                sum += e.chain_variance[i] / (picture * picture);
                by_met += relative_met * e.chain[i] * e.chain[i] / (picture * picture);
            }
        }
    return fmax(sum - by_met, 0.1 * sum) / (3 * (double)r->pixels);
}

void render_image(const Render *r, Image *image)
{
    Estimator all = estimator(r);
    float *rgb = image->rgb;
    if (!run_begun(r) && r->early) {           /* since it is divided, too little has been done to make up the integrand */
        memcpy(rgb, r->early->rgb, 3 * r->pixels * sizeof *rgb);
        return;
    }
    for (uint32_t y = 0; y < image->height; y++)
        for (uint32_t x = 0; x < image->width; x++) {
            Estimate e = estimate(&all, x, y);
            for (int i = 0; i < 3; i++) *rgb++ = (float)e.value[i];
        }
}

void render_error_image(const Render *r, Image *image)
{
    Estimator all = estimator(r);
    float *rgb = image->rgb;
    for (uint32_t y = 0; y < image->height; y++)
        for (uint32_t x = 0; x < image->width; x++) {
            Estimate e = estimate(&all, x, y);
            for (int i = 0; i < 3; i++) *rgb++ = !run_begun(r) && r->early ? 0 : (float)sqrt(e.sampled_variance[i] + e.chain_variance[i]);
        }
}
