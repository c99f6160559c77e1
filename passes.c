/* Independent samples: passes over the film, row by row. See render.c for what they have of the integrand.
 *
 * Some pixels are noisier than others, beside their brightness, and should have more samples. How many is settled once, by the first samples of the pixels
 * around (run_share_out). A pixel's own have no part in it: those that happen to be dark would else be looked at less often from then on, and weigh
 * less in the mean. (The samples of a pixel fill their ranges evenly: those to come are not independent of those so far.)
 */
#include "run.h"
#include <string.h>

/* A sample of a pixel that has so many in a pass: what it brings to others, or leaves to the chains, counts by so much less. (But for light subpaths,
 * which know nothing of the pixel: there are as many of them as without.) */
typedef struct { Render *r; Rng *rng; double often; Rgb own; double cut; bool out_of_memory; } Splat;

static void add_direct(const Splat *s, const Candidate *c)
{
    if (reach_is_direct(c->reach) && finite3(c->rgb)) s->r->passes.direct[c->pixel] += c->share / s->often * (c->rgb.x + c->rgb.y + c->rgb.z);
}

static void visit_traced(void *context, const Candidate *c)
{
    Splat *s = context;
    add_direct(s, c);
    if (c->share == 1) return;
    if (c->reach == REACH_SEEN) s->out_of_memory |= !run_spread(s->r, c, 1 / s->often, s->rng);
    else {
        double scale = c->n_lens > 1 ? 1 / s->often : 1;
        s->cut += scale * (1 - c->share) * (c->rgb.x + c->rgb.y + c->rgb.z) / 3;
        run_meet(s->r, c, scale, s->rng);
    }
}

static void splat_light(Render *r, size_t pixel, Rgb rgb)
{
    double *light = r->passes.light + 3 * pixel, *square = r->passes.light_square + 3 * pixel;
    const double v[3] = { rgb.x, rgb.y, rgb.z };
    for (int i = 0; i < 3; i++) { light[i] += v[i]; square[i] += v[i] * v[i]; }
}

static void splat_candidate(void *context, const Candidate *c)
{
    Splat *s = context;
    if (!finite3(c->rgb)) { s->r->stats.bad_samples++; return; }
    if (c->n_lens > 1) {
        s->own = along(s->own, c->share, c->rgb);
        visit_traced(s, c);
        return;
    }
    if (c->share < 1) visit_traced(s, c);
    splat_light(s->r, c->pixel, scale(c->share, c->rgb));
}

/* On the whole integrand: indirect light, from pixels drawn by chance (a pattern would be seen in the caps), all of it apart from the path tracer's. */
static void sample_joined(Render *r, double x, double y, size_t pixel, Rng *rng)
{
    Splat s = { .r = r, .rng = rng, .often = 1 };
    bdpt_sample(r->bdpt, &r->joined_space, x, y, BOTH_WAYS, NULL, rng, splat_candidate, &s);
    if (finite3(s.own)) splat_light(r, pixel, s.own);
}

/* Rows in an order in which some that follow each other are spread over the film, from a chance one on: each is as likely as any other to be in a round. */
static uint32_t row_of(const Render *r)
{
    uint64_t height = r->scene->camera.height, stride = (uint64_t)(0.6180339887 * (double)height) | 1, start;
    for (uint64_t a = height, b = stride; ; a = height, b = stride += 2) {
        while (b != 0) { uint64_t rest = a % b; a = b; b = rest; }
        if (a == 1) break;
    }
    Rng rng = rng_new(r->settings->seed, (uint64_t)5 << 61);
    start = rng_index(&rng, (uint32_t)height);
    return (uint32_t)((start + r->passes.rows % height * stride) % height);
}

/* Of their own for the pilot: were its samples seen again, the thresholds would depend on what they are to cap. */
static uint64_t sample_stream(const Render *r) { return (uint64_t)(r->pilot ? 7 : 6) << 61; }

/* The i-th sample of a pixel. Its place there and the first choices on its way fill their ranges evenly over the pixel's samples; where they are two
 * sequences, in turn, over each of both. */
static bool sample_pixel(Render *r, uint32_t column, uint32_t row, uint64_t i, double often, Rng *rng)
{
    Passes *p = &r->passes;
    size_t pixel = (size_t)row * r->scene->camera.width + column;
    bool in_two = run_in_two(r, column, row), first = in_two && i % 2 == 0;
    Rng offset = rng_new(r->settings->seed, sample_stream(r) + ((uint64_t)first << 59) + pixel);
    union { Numbers named; double u[NUMBERS]; } even_ones;
    for (int d = 0; d < NUMBERS; d++) even_ones.u[d] = even(rng_double(&offset), in_two ? i / 2 : i, d);
    uint64_t rays = *r->scene->rays;
    double x = column + even_ones.u[0], y = row + even_ones.u[1];
    Splat s = { .r = r, .rng = rng, .often = often };
    if (r->settings->integrator != INTEGRATOR_BDPT && !(r->bidirectional && r->direct_joined))
        s.own = path_trace(&r->direct_space, column, row, &even_ones.named, rng, r->trail, visit_traced, &s);
    if (run_on_whole(r) && rng_index(rng, JOINED_STRIDE) == 0) sample_joined(r, x, y, pixel, rng);
    if (r->bidirectional) bdpt_sample(r->bdpt, &r->joined_space, x, y, BOTH_WAYS, &even_ones.named, rng, splat_candidate, &s);
    run_end_sample(r);
    if (!p->settled) p->cost[pixel] += (float)(*r->scene->rays - rays);
    if (s.out_of_memory) return false;
    if (!finite3(s.own)) { r->stats.bad_samples++; return true; }
    p->cut += s.cut;
    p->cut_square += s.cut * s.cut;
    const double v[3] = { s.own.x, s.own.y, s.own.z };
    for (size_t c = 0; c < 3; c++) { p->sum[3 * pixel + c] += v[c]; p->square[3 * pixel + c] += v[c] * v[c]; }
    for (size_t c = 0; first && c < 3; c++) run_first(r, column, row)[c] += v[c];
    return true;
}

bool run_sample_row(Render *r)
{
    Passes *p = &r->passes;
    uint32_t width = r->scene->camera.width, row = row_of(r);
    uint64_t pass = p->count[row];
    uint64_t rays = *r->scene->rays;
    Rng rng = rng_new(r->settings->seed, sample_stream(r) + ((uint64_t)1 << 60) + p->rows);
    for (uint32_t column = 0; column < width; column++) {
        size_t pixel = (size_t)row * width + column;
        uint64_t end = run_samples(p, pixel, row, pass + 1);
        double often = p->settled ? (double)p->often[pixel] : 1;
        for (uint64_t i = run_samples(p, pixel, row, pass); i < end; i++)
            if (!sample_pixel(r, column, row, i, often, &rng)) return false;
        if (r->catches && (p->rows * width + column) % RUN_CATCH_STRIDE == 0) run_catch(r, &rng);
    }
    p->rows++;
    p->count[row]++;
    r->met.rows++;
    r->met.rays += (double)(*r->scene->rays - rays);
    p->rays += *r->scene->rays - rays;
    return true;
}

void run_forget_samples(Render *r)
{
    Passes *p = &r->passes;
    double *thrown_away[] = { p->sum, p->square, p->light, p->light_square };
    for (size_t i = 0; i < sizeof thrown_away / sizeof *thrown_away; i++)
        if (thrown_away[i]) memset(thrown_away[i], 0, 3 * r->pixels * sizeof(double));
    memset(p->first, 0, run_firsts(r) * sizeof *p->first);
    memset(p->cost, 0, r->pixels * sizeof *p->cost);
    memset(p->direct, 0, r->pixels * sizeof *p->direct);
    memset(p->count, 0, r->scene->camera.height * sizeof *p->count);
    p->rows = p->rays = 0;
    p->settled = false;
    p->evenness = (Evenness){ .mean = 0 };
    p->cut = p->cut_square = 0;
}
