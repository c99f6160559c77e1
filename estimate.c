/* The picture as it stands, its estimated error, and whether the rounds have found the same light. See render.h.
 *
 * All of it is read from the accumulators of run.h; what is learned from it steers the rounds to come.
 */
#include "run.h"
#include <stdlib.h>

enum { LEAST_ROUNDS = 6 };         /* that can be said to agree or not */

/* Value i (channel i % 3) of the picture, and the variance of that value: from independent samples and from chains; the variance of the
 * chains' part is known once two rounds are done. */
typedef struct { double value, chain /* the chains' part of it */, sampled_variance, chain_variance; } Estimate;

static Estimate estimate(const Render *r, size_t i)
{
    Estimate e = { 0, 0, 0, 0 };
    const Passes *p = &r->passes;
    if (r->has_direct) {
        uint32_t width = r->scene->camera.width, height = r->scene->camera.height;
        double n = p->count[i / 3 / width];
        if (n > 0) e.value = p->sum[i] / n;
        if (n > 1) e.sampled_variance = fmax(0, p->square[i] / n - e.value * e.value) / (n - 1);
        if (p->light && p->rows > 0) {
            double scale = (double)height / (double)p->rows;
            e.value += scale * p->light[i];
            e.sampled_variance += scale * scale * p->light_square[i];
        }
    }
    double steps = r->steps_sum + r->round.steps;
    if (r->has_chain && steps > 0) {
        e.chain = (r->sum[i] + r->round.b * (double)r->pixels * r->film[i / 3].sum[i % 3]) / steps;
        e.value += e.chain;
        double share = r->steps_sum > 0 ? r->steps_square / (r->steps_sum * r->steps_sum) : 1;
        if (share < 1) {
            double mean = r->sum[i] / r->steps_sum;
            e.chain_variance = fmax(0, r->square[i] / r->steps_sum - mean * mean) * share / (1 - share) * (r->steps_sum / steps);
        }
    }
    return e;
}

static float smaller_f(float a, float b) { return a < b ? a : b; }
static uint32_t smaller_u(uint32_t a, uint32_t b) { return a < b ? a : b; }
static float larger_f(float a, float b) { return a < b ? b : a; }

static float median5(const float v[5])
{
    float low = larger_f(smaller_f(v[0], v[1]), smaller_f(v[2], v[3])), high = smaller_f(larger_f(v[0], v[1]), larger_f(v[2], v[3]));
    return larger_f(smaller_f(low, high), smaller_f(larger_f(low, high), v[4]));   /* low, high: the middle two of four */
}

/* Along rows, then along columns: each pixel becomes combine(itself, two to the left and right that are 'stride' apart). */
static void filter(const Render *r, float *picture, float *work, uint32_t stride, float (*combine)(const float v[5]))
{
    uint32_t width = r->scene->camera.width, height = r->scene->camera.height;
    for (int pass = 0; pass < 2; pass++) {
        const float *from = pass == 0 ? picture : work;
        uint32_t last = (pass == 0 ? width : height) - 1;
        for (uint32_t y = 0; y < height; y++)
            for (uint32_t x = 0; x < width; x++) {
                uint32_t at = pass == 0 ? x : y;
                float v[5];
                for (uint32_t i = 0; i < 5; i++) {
                    uint32_t to = at + stride * i < 2 * stride ? 0 : smaller_u(at + stride * i - 2 * stride, last);
                    v[i] = from[pass == 0 ? (size_t)y * width + to : (size_t)to * width + x];
                }
                (pass == 0 ? work : picture)[(size_t)y * width + x] = combine(v);
            }
    }
}

static float mean5(const float v[5]) { return (v[0] + v[1] + v[2] + v[3] + v[4]) / 5; }

/* The picture's brightness without its outliers, a mean over channels: the median of the surroundings, or, for small features, the mean of so much of
 * nearby values as lies above their standard errors. By a plain mean one firefly would starve its surroundings of chains and so beget
 * others. *mean receives that of the picture. False if memory runs out. */
static bool typical_brightness(const Render *r, float *out, double *mean)
{
    float *safe = malloc(r->pixels * sizeof *safe), *work = malloc(r->pixels * sizeof *work);
    bool ok = safe && work;
    *mean = 0;
    if (ok) {
        for (size_t pixel = 0; pixel < r->pixels; pixel++) {
            double value = 0, error = 0;
            for (size_t i = 3 * pixel; i < 3 * pixel + 3; i++) {
                Estimate e = estimate(r, i);
                value += e.value / 3;
                error += sqrt(e.sampled_variance + e.chain_variance) / 3;
            }
            *mean += value / (double)r->pixels;
            out[pixel] = (float)value;
            safe[pixel] = (float)fmax(0, value - error);
        }
        filter(r, out, work, 2, median5);
        filter(r, safe, work, 1, mean5);
        for (size_t pixel = 0; pixel < r->pixels; pixel++) out[pixel] = larger_f(out[pixel], safe[pixel]);
    }
    free(safe);
    free(work);
    return ok;
}

/* What the value may be, to divide its error by. Variances are largest where values came out too large by chance: divided by the values themselves
 * the error would come out too small. So a value differs from its surroundings only by so much as its standard error does not explain
 * (James and Stein's rule for one value); nothing is left of a firefly, whose standard error is as large as itself. */
static double likely_value(double value, double variance, double typical)
{
    double difference = value - typical, squared = difference * difference;
    return squared > variance ? value - difference * (variance / squared) : typical;
}

/* What to expect of a pixel's values: what is typical, unless there is far more direct light. A lamp, or its image, may be seen in one pixel alone and
 * fill so little of that one that its samples look like outliers; but direct light has none. */
static double surroundings(const Render *r, size_t pixel, double typical)
{
    double n = r->has_direct ? r->passes.count[pixel / r->scene->camera.width] : 0, direct = n > 0 ? r->passes.direct[pixel] / (3 * n) : 0;
    return direct > 4 * typical ? direct : typical;
}

static uint32_t tiles_along(uint32_t pixels) { return smaller_u(TILES_ACROSS, pixels < 2 * TILE_PIXELS ? 1 : pixels / TILE_PIXELS); }

uint32_t run_tiles(const Render *r) { return tiles_along(r->scene->camera.width) * tiles_along(r->scene->camera.height); }

uint32_t run_tile(const Render *r, size_t pixel)
{
    uint32_t width = r->scene->camera.width, height = r->scene->camera.height, across = tiles_along(width);
    return (uint32_t)(pixel / width * tiles_along(height) / height) * across + (uint32_t)(pixel % width * across / width);
}

/* Whether the rounds have found the same light. Pixels cannot tell: in most of them a round leaves little. In a tile where one round has brought more
 * than all others together, it has come upon paths that the others have missed, or one of its chains has been caught; how much of that light
 * there ought to be is then known to no one, and the spread between rounds does not tell it. 'mean' is that of the picture. */
static void learn_agreement(Render *r, double mean)
{
    enum { ALL = TILES_ACROSS * TILES_ACROSS };
    uint32_t tiles = run_tiles(r);
    double light[ALL] = { 0 }, variance[ALL] = { 0 }, values[ALL] = { 0 }, energy = 0, unevenness = 0, sum = 0;
    for (size_t pixel = 0; pixel < r->pixels; pixel++) {
        uint32_t tile = run_tile(r, pixel);
        double error = 0;
        for (size_t i = 3 * pixel; i < 3 * pixel + 3; i++) {
            Estimate e = estimate(r, i);
            light[tile] += e.value;
            sum += e.chain;
            error += sqrt(e.sampled_variance);     /* channels err together, pixels apart */
        }
        variance[tile] += error * error;
        values[tile] += 3;
    }
    double rounds = r->steps_square > 0 ? r->steps_sum * r->steps_sum / r->steps_square : 0;   /* as many of equal length */
    RenderStats *s = &r->stats;
    s->tiles = tiles;
    s->tiles_disagreeing = 0;
    s->largest_tile_error = 0;
    s->chain_part = sum / (3 * (double)r->pixels * mean);
    for (uint32_t t = 0; t < tiles; t++) {
        const Tile *tile = &r->tile[t];
        double value = light[t] / values[t], chain = rounds > 0 ? tile->sum / r->steps_sum : 0, chain_variance = 0;
        if (rounds > 1) chain_variance = fmax(0, tile->square / r->steps_sum - chain * chain) / (rounds - 1);
        energy += values[t] * chain;
        unevenness += values[t] * values[t] * chain_variance;
        s->largest_tile_error = fmax(s->largest_tile_error, sqrt((variance[t] / (values[t] * values[t]) + chain_variance) / (value * value + 0.01 * mean * mean)));
        if (rounds < LEAST_ROUNDS) continue;
        double others = (tile->sum - tile->largest) / r->steps_sum * (rounds / (rounds - 1));
        s->tiles_disagreeing += tile->largest > 0.5 * tile->sum && chain - others > 0.1 * value + 0.01 * mean;
    }
    s->rounds = (uint32_t)(rounds + 0.5);
    if (r->has_chain && rounds < LEAST_ROUNDS) s->largest_tile_error = NAN;
    s->effective_samples = rounds < LEAST_ROUNDS ? NAN : energy * energy / unevenness;
}

/* The error of two kinds of work falls as 1/rays in each; together it is least where rays go as sqrt(error * rays). */
static double best_share(double error, uint64_t rays, double other_error, uint64_t other_rays, double most)
{
    double share = sqrt(error * (double)rays / (other_error * (double)other_rays));
    return share > 0.02 ? fmin(share, most) : 0.02;    /* NaN too */
}

/* After a round: the estimated relMSE, the shares of rays that direct light and bootstrap should have, and the two-stage weight. */
void run_learn(Render *r)
{
    float *local = malloc(r->pixels * sizeof *local);
    double mean, sampled = 0, chain = 0, chain_energy = 0;   /* the last three relative to the picture, summed over values */
    if (!local || !typical_brightness(r, local, &mean)) {    /* goes on with what it knew */
        free(local);
        return;
    }
    if (mean > 0) {
        for (size_t pixel = 0; pixel < r->pixels; pixel++) {
            double typical = (double)local[pixel], around = surroundings(r, pixel, typical);
            for (size_t i = 3 * pixel; i < 3 * pixel + 3; i++) {
                Estimate e = estimate(r, i);
                double likely = likely_value(e.value, e.sampled_variance + e.chain_variance, around), relative_to = likely * likely + 0.01 * mean * mean;
                sampled += e.sampled_variance / relative_to;
                chain += e.chain_variance / relative_to;
                chain_energy += e.chain * e.chain / relative_to;
            }
            /* pixels in proportion to their relative error: w ~ 1/picture, floored so that none starves */
            if (r->has_chain) r->film[pixel].weight = (float)(mean / (typical + 0.05 * mean));
            if (r->has_chain && r->chain_space.part == WHOLE) r->film[pixel].threshold = (float)(typical + 0.05 * mean);   /* survey scales it */
        }
        double values = 3 * (double)r->pixels;
        bool known = !r->has_chain || r->stats.b == 0 || r->steps_square < r->steps_sum * r->steps_sum;
        if (known) r->relative_error = sqrt((sampled + chain) / values);
        if (known && r->has_chain && r->stats.b > 0) {
            if (r->has_direct) r->direct_share = best_share(sampled, r->passes.rays, chain, r->stats.chain_rays + r->stats.start_rays, r->settings->seconds > 0 ? 50 : 4);
            r->chain_error = chain / values;
            /* what the uncertain b alone contributes */
            double relative_b = r->b_variance_sum / (r->b_sum * r->b_sum), by_b = relative_b * chain_energy;
            r->start_share = best_share(by_b, r->stats.start_rays, fmax(chain - by_b, 0.1 * chain), r->stats.chain_rays, 2);
        }
        learn_agreement(r, mean);
    } else if (!r->has_chain || r->stats.bootstrap_hits == 0) r->relative_error = 0;     /* black, and nothing says that it should not be */
    free(local);
}

void render_image(const Render *r, Image *image)
{
    for (size_t i = 0; i < 3 * r->pixels; i++) image->rgb[i] = (float)estimate(r, i).value;
}

void render_error_image(const Render *r, Image *image)
{
    for (size_t i = 0; i < 3 * r->pixels; i++) {
        Estimate e = estimate(r, i);
        image->rgb[i] = (float)sqrt(e.sampled_variance + e.chain_variance);
    }
}
