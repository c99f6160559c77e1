/* The audit. See audit.h.
 *
 *   is R = f/T?              f and T in long double from densities and G alone, all caches recomputed from points and modes
 *   do proposals follow T?   chi-square tests: labels (k_d, s, k_a) and j of the bidirectional mutation, first ray and first turn of the others
 *   is anything gained?      each row alone, a few steps from starts that follow f* exactly; sums over three families of classes of paths
 *   all of it                the states to ask at, and the findings as a table
 */
#include "audit.h"
#include <inttypes.h>

enum { STATES = 8, AGAIN = 50, ENOUGH = 100,                  /* states with a histogram each; steps between them, and counts for a bin; terms for a sum */
       U_BINS = 6, PHI_BINS = 6, BINS = U_BINS * PHI_BINS + 1, K_BINS = 6, S_BINS = 16, LABELS = K_BINS * S_BINS * K_BINS + 1, J_BINS = 8,
       FAMILY = 2048, FAMILIES = 3, OCTAVE_BINS = 800, FLOW_STEPS = 16, KEEP = 30, ALL = 4096 };
static const double false_alarm = 1e-6, worst_allowed = 1e-6;    /* of the whole audit; relative difference of R */
static const double worst_spread = 1e-2;       /* the same where it is by differences, over vertices that rays have left at a small distance */
typedef long double Real;

/* What was found about one row. */
typedef struct {
    uint64_t proposals, outcome[OUTCOMES], accepted;
    double worst, chi_squared, z_flow;
    int freedom, states, classes;
    double sum[FAMILY * FAMILIES], square[FAMILY * FAMILIES], largest[FAMILY * FAMILIES];
} Finding;

typedef struct {
    const Space *space;
    const Sampler *sampler;
    int only;                                  /* the row that is audited; negative: all */
    const Bootstrap *seeds;
    Bdpt *bdpt;
    Path x, y, start, proposal, fresh_x, fresh_y;
    Finding finding[MUTATIONS];
    /* flows: the candidates of one bidirectional sample; then what a start has moved so far */
    double cap, weight_sum, octave[OCTAVE_BINS];
    int candidates;
    Candidate candidate[ALL];
    double recorded, flow[FAMILY * FAMILIES];
    int n_touched;
    unsigned touched[FAMILIES * (2 * FLOW_STEPS + 2)];
} Lab;

static bool is_audited(const Lab *lab, int r) { return lab->sampler->share[r] > 0 && (lab->only < 0 || lab->only == r); }

/* ---- is R = f/T? ---- */

/* p of the direction that was drawn at z_i, per projected solid angle: the probability of its mode at a specular vertex, where f has the same delta;
 * 1 for a copied mode; per area at a light point, 1 at a lens point. */
static Real pdf_to_lens(const Path *z, int i, bool copied)
{
    if (i < 0) return z->light_pdf_a;
    return (Real)value_F(z, i) * z->v[i].s.inv_S_lens / (copied ? z->v[i].s.q : 1);
}
static Real pdf_to_light(const Path *z, int i, bool copied)
{
    if (i > z->k) return 1;
    return (Real)value_F(z, i) * z->v[i].s.inv_S_light / (copied ? z->v[i].s.q : 1);
}

/* F_s G_s .. F_t: the factors of f between two vertices, as far as there are any */
static Real f_between(const Path *z, int s, int t)
{
    Real f = 1;
    for (int i = s < 0 ? 0 : s; i <= t && i <= z->k; i++) f *= value_F(z, i) * (i < t && i < z->k ? 1 / (Real)z->v[i].inv_G : 1);
    return f;
}

/* sum over ways j of p_a2[j] * density per area of the vertices between z_s and z_t: one ray after the other, every G written out */
static Real density_of_ways(const Path *z, int s, int t)
{
    int m = t - s - 1, ways = 0;
    bool light = s < 0 && m == 0, specular_s = path_specular(z, s), specular_t = path_specular(z, t);
    Real sum = 0;
    if (s >= z->k || (light && (t >= z->k || !material_emits(z->v[0].point.surface.material)))) return 0;
    for (int j = 0; j <= m; j++) {
        int e = s + j;
        if (!light && ((j == 0 && specular_s) || (j == m && (specular_t || t > z->k)))) continue;
        ways++;
        if (path_specular(z, e) || path_specular(z, e + 1)) continue;
        Real p = 1;
        for (int i = s; i < e; i++) p *= pdf_to_lens(z, i, false) * (i < 0 ? 1 : 1 / (Real)z->v[i].inv_G);
        for (int i = t; i > e + 1; i--) p *= pdf_to_light(z, i, false) * (i > z->k ? 1 : 1 / (Real)z->v[i - 1].inv_G);
        sum += p;
    }
    return ways ? sum / ways : 0;
}

static Real slow_p_d1(int k, int k_d)
{
    Real sum = 0;
    for (int e = 1; e <= k + 2; e++) sum += raw_p_d1(e);
    return raw_p_d1(k_d) / sum;
}

static Real slow_p_a1(int k, int k_d, int k_a, int max_depth)
{
    Real sum = 0;
    for (int e = 1; e <= k_d - k + max_depth; e++)
        if (k - k_d + e >= 1) sum += raw_p_a1(e - k_d);
    return raw_p_a1(k_a - k_d) / sum;
}

static Real slow_p_d2(const Tuning *tuning, const Path *z, int s, int k_d)
{
    Real W = 0, mine = 0;
    int n = z->k + 3 - k_d;
    for (int i = -1; i + k_d <= z->k + 1; i++) {
        Real w = density_of_ways(z, i, i + k_d) / f_between(z, i, i + k_d) * (i < 0 ? tuning->light_scale : 1);
        W += w;
        if (i == s) mine = w;
    }
    return (1 - (Real)tuning->p_d2_importance) / n + (W > 0 ? tuning->p_d2_importance * mine / W : 0);
}

/* manifold_spread by differences: rays from the last D, turned from the path's by 'aside', against the planes of the triangles that z has. */
static Real slow_spread(const Lab *lab, const Path *z, const Path *like, double aside)
{
    static const double H = 1e-5;
    const Scene *scene = lab->space->scene;
    int last = manifold_diffuse(z);
    Vec3 a, b, w0 = neg(z->v[last - 1].to_lens), end[4];
    frame(w0, &a, &b);
    w0 = normalize(along(w0, aside, add(a, b)));
    for (int n = 0; n < 4; n++) {
        Point at = z->v[last].point;
        Vec3 w = normalize(along(w0, n % 2 ? -H : H, n < 2 ? a : b));
        for (int i = last - 1; i >= 0; i--) {
            const Point *old = &z->v[i].point;
            Point corner[3];
            Vec3 p = along(at.p, dot(sub(old->p, at.p), old->surface.ng) / dot(w, old->surface.ng), w), known = neg(w);
            if (i == 0) { end[n] = p; break; }
            scene_triangle_point(scene, old->triangle, 0, 0, &corner[0]);
            scene_triangle_point(scene, old->triangle, 1, 0, &corner[1]);
            scene_triangle_point(scene, old->triangle, 0, 1, &corner[2]);
            Vec3 e1 = sub(corner[1].p, corner[0].p), e2 = sub(corner[2].p, corner[0].p), from = sub(p, corner[0].p), across = cross(e1, e2);
            double squared = dot(across, across);
            scene_triangle_point(scene, old->triangle, dot(cross(from, e2), across) / squared, dot(cross(e1, from), across) / squared, &at);
            const Passage passage = path_passage(like, i, true);
            if (!bsdf_pass(&at.surface, known, &passage, &w)) return NAN;
        }
    }
    return 4 * H * H / length(cross(sub(end[0], end[1]), sub(end[2], end[3])));
}

/* Rays leave a surface a little beside it (scene.h): where edges are short, a path obeys the laws of its sharp vertices only so far. What that may
 * change of |dw/dx_0|, where it changes fast. */
static double uncertain_spread(const Lab *lab, const Path *z, const Path *like)
{
    static const double BESIDE = 1e-6, OFTEN = 4;
    double shortest = 1;
    for (int i = 0; i < manifold_diffuse(z); i++) shortest = fmin(shortest, length(sub(z->v[i + 1].point.p, z->v[i].point.p)));
    double change = OFTEN * fabs((double)(slow_spread(lab, z, like, BESIDE / shortest) / slow_spread(lab, z, like, 0)) - 1);
    return isnan(change) ? INFINITY : change;  /* at the rim of what is seen through glass */
}

/* T(z|from), but for the density of steps, which is the same both ways. A perturbation moved what lies beyond z_m. */
static Real slow_T(int row, const Lab *lab, const Path *from, const Path *z, int s, int k_d, int k_a, int m)
{
    Real T = 1;
    if (row == BIDIR)
        return slow_p_d1(from->k, k_d) * slow_p_d2(&lab->sampler->tuning, from, s, k_d) * slow_p_a1(from->k, k_d, k_a, lab->space->max_depth)
            * density_of_ways(z, s, s + k_a);
    if (row == CAUSTIC)
        for (int i = m; i < z->k - 1; i++)
            T *= (i == m || !path_specular(z, i) ? 1 / fabs(dot(z->v[i].to_lens, z->v[i].point.surface.ng)) : pdf_to_lens(z, i, true)) / z->v[i].inv_G;
    else
        for (int i = z->k; i > m; i--) {
            bool turned = row != SUBPATH && i < z->k && !path_specular(z, i);
            T *= (turned ? 1 / fabs(dot(z->v[i - 1].to_lens, z->v[i].point.surface.ng)) : pdf_to_light(z, i, row != SUBPATH)) / z->v[i - 1].inv_G;
            if (row == MANIFOLD && i == manifold_diffuse(z)) T /= slow_spread(lab, z, from, 0);
        }
    return T;
}

/* All caches anew, from nothing but points and modes. */
static bool refresh(const Space *space, const Path *from, Path *to)
{
    path_copy(to, from);
    to->raster_x = to->raster_y = to->light_pdf_a = to->chi = NAN;
    to->pixel = 0;
    for (int i = 0; i <= to->k; i++) {
        Vertex fresh = { .point = to->v[i].point, .mode = to->v[i].mode };
        to->v[i] = fresh;
    }
    return path_evaluate(space, to) && to->chi > 0;
}

/* Relative difference of R(y|x)/R(x|y) as the row said it from f(y) T(x|y) / ( f(x) T(y|x) ) evaluated whole and from scratch. */
static double difference_of_R(int row, Lab *lab, const Path *x, const Path *y, const Move *move)
{
    const Path *a = &lab->fresh_x, *b = &lab->fresh_y;
    if (!refresh(lab->space, x, &lab->fresh_x) || !refresh(lab->space, y, &lab->fresh_y)) return INFINITY;
    int m = row == CAUSTIC ? move->first - 1 : move->first;
    Real f_x = a->chi * f_between(a, 0, a->k), f_y = b->chi * f_between(b, 0, b->k);
    Real there = slow_T(row, lab, a, b, move->s, move->k_d, move->k_a, m), back = slow_T(row, lab, b, a, move->s, move->k_a, move->k_d, m);
    if (isinf(move->R_xy) || back == 0) return isinf(move->R_xy) && back == 0 ? 0 : INFINITY;    /* no way back by either account */
    double difference = (double)fabsl((f_y * back) / (f_x * there) * move->R_xy / move->R_yx - 1);
    if (row == MANIFOLD && !(difference <= worst_spread)) difference -= fmin(difference, uncertain_spread(lab, a, b) + uncertain_spread(lab, b, a));
    return isnan(difference) ? INFINITY : difference;
}

/* ---- do proposals follow T? ---- */

/* Two samples of one distribution, or a sample and what is expected of it; bins of few counts are taken together. */
static void add_chi_squared(Finding *f, const double *a, const double *b, int bins, bool b_is_exact)
{
    double a_few = 0, b_few = 0;
    int used = 0;
    for (int i = 0; i <= bins; i++) {
        double p = i < bins ? a[i] : a_few, q = i < bins ? b[i] : b_few, expected = b_is_exact ? q : (p + q) / 2;
        if (i < bins && expected < AGAIN) { a_few += p; b_few += q; continue; }
        if (!(expected > 0)) continue;
        f->chi_squared += (p - q) * (p - q) / (b_is_exact ? q : p + q);
        used++;
    }
    if (used > 1) f->freedom += used - 1;
}

/* A chi-square as a normal deviate [Wilson and Hilferty]. */
static double deviate(double chi_squared, int freedom)
{
    double v = 2 / (9.0 * freedom);
    return (cbrt(chi_squared / freedom) - 1 + v) / sqrt(v);
}

/* The bin that holds a value, the first and the last for what lies outside. */
static unsigned bin(double value, double low, double step, unsigned bins)
{
    double i = floor((value - low) / step);
    return i > 0 ? i < bins ? (unsigned)i : bins - 1 : 0;
}

/* Bin of a step: how far, on a logarithmic scale, and whereto. */
static unsigned step_bin(double u, double phi)
{
    return bin(u * U_BINS, 0, 1, U_BINS) * PHI_BINS + bin((phi / (2 * PI) + 1) * PHI_BINS, 0, 1, 2 * PHI_BINS) % PHI_BINS;
}

static unsigned film_bin(const Lab *lab, int row, const Path *x, const Point *lens, Vec3 w)
{
    const Camera *camera = &lab->space->scene->camera;
    const Tuning *t = &lab->sampler->tuning;
    double px = NAN, py = NAN, we;
    camera_project(camera, lens, w, &px, &py, &we);
    if (row == SUBPATH) return step_bin(px / camera->width, 2 * PI * py / camera->height);
    return step_bin(log(hypot(px - x->raster_x, py - x->raster_y) / t->r2) / t->log_r, atan2(py - x->raster_y, px - x->raster_x));
}

static unsigned turn_bin(const Lab *lab, Vec3 old, Vec3 w)
{
    const Tuning *t = &lab->sampler->tuning;
    Vec3 a, b;
    frame(old, &a, &b);
    return step_bin(log(angle(old, w) / t->theta2) / t->log_theta, atan2(dot(w, b), dot(w, a)));
}

/* The kernels, written down a second time: a step on the film, or a turned direction; and where its ray ends, in the bins above. */
static unsigned reference_film(const Lab *lab, int row, const Path *x, Rng *rng)
{
    const Camera *camera = &lab->space->scene->camera;
    const Tuning *t = &lab->sampler->tuning;
    double u = rng_double(rng), phi = 2 * PI * rng_double(rng), r = t->r2 * exp(t->log_r * u), px = x->raster_x + r * cos(phi), py = x->raster_y + r * sin(phi);
    Point lens = x->v[x->k].point, hit;
    if (row == SUBPATH) {
        camera_sample_lens(camera, rng, &lens);
        px = u * camera->width;
        py = phi / (2 * PI) * camera->height;
    }
    if (!(px >= 0 && px < camera->width && py >= 0 && py < camera->height)) return BINS - 1;
    bool met = scene_trace(lab->space->scene, &lens, camera_direction(camera, &lens, px, py), &hit);
    return met ? film_bin(lab, row, x, &lens, normalize(sub(hit.p, lens.p))) : BINS - 1;
}

static unsigned reference_turn(const Lab *lab, const Point *at, Vec3 old, Rng *rng)
{
    const Tuning *t = &lab->sampler->tuning;
    double theta = t->theta2 * exp(t->log_theta * rng_double(rng)), phi = 2 * PI * rng_double(rng);
    Vec3 a, b;
    Point hit;
    frame(old, &a, &b);
    Vec3 w = along(along(scale(cos(theta), old), sin(theta) * cos(phi), a), sin(theta) * sin(phi), b);
    return scene_trace(lab->space->scene, at, normalize(w), &hit) ? turn_bin(lab, old, normalize(sub(hit.p, at->p))) : BINS - 1;
}

/* lab->proposal from x; an edge of it whose inv_G is then positive has been traced. */
static Move propose_anew(int row, Lab *lab, const Path *x, Rng *rng)
{
    Move move = { .s = 0 };
    Path *y = &lab->proposal;
    for (int v = 0; v <= lab->space->max_depth; v++) y->v[v].inv_G = -1;
    y->k = x->k;
    lab->sampler->table[row].propose(lab->space, &lab->sampler->tuning, x, y, rng, &move);
    return move;
}

static unsigned label(int k_d, int s, int k_a)
{
    bool in = k_d <= K_BINS && k_a <= K_BINS && s + 1 < S_BINS;
    return in ? (unsigned)(((k_d - 1) * S_BINS + s + 1) * K_BINS + k_a - 1) : LABELS - 1;
}

/* bidir, from one x: labels (k_d, s, k_a), and j among its ways, against p_d1 p_d2 p_a1 p_a2. */
static void audit_labels(Finding *f, Lab *lab, const Path *x, uint64_t n, Rng *rng)
{
    double seen[LABELS] = { 0 }, expected[LABELS] = { [LABELS - 1] = (double)n }, j_seen[J_BINS] = { 0 }, j_expected[J_BINS] = { 0 };
    for (uint64_t i = 0; i < n; i++) {
        Move move = propose_anew(BIDIR, lab, x, rng);
        int ways = 0;
        seen[label(move.k_d, move.s, move.k_a)]++;
        if (move.s < x->k && bidir_ways(x, move.s, move.t, move.k_d - 1) > 0) ways = bidir_ways(&lab->proposal, move.s, move.s + move.k_a, move.k_a - 1);
        if (ways < 2) continue;
        int first = move.s >= 1 && material_is_specular(x->v[move.s].point.surface.material);
        double u = (move.j - first + rng_double(rng)) / ways;          /* uniform if j is uniform over its ways */
        j_seen[bin(u * J_BINS, 0, 1, J_BINS)] += u >= 0 && u < 1 ? 1 : (double)n;
        for (int b = 0; b < J_BINS; b++) j_expected[b] += 1.0 / J_BINS;
    }
    for (int k_d = 1; k_d <= K_BINS && k_d <= x->k + 2; k_d++)
        for (int s = -1; s + 1 < S_BINS && s + k_d <= x->k + 1; s++)
            for (int k_a = 1; k_a <= K_BINS; k_a++) {
                double p = bidir_p_d1(x->k, k_d) * bidir_p_d2(&lab->sampler->tuning, x, s, s + k_d) * bidir_p_a1(x->k, k_d, k_a, lab->space->max_depth);
                expected[label(k_d, s, k_a)] = p * (double)n;
                expected[LABELS - 1] -= p * (double)n;
            }
    add_chi_squared(f, seen, expected, LABELS, true);
    add_chi_squared(f, j_seen, j_expected, J_BINS, true);
}

/* The others, from one x: where the first ray goes, and for the chain the first turned one, against rays of our own; what is lost counts as a
 * bin, so that no edge of the film matters. */
static void audit_steps(Finding *f, int row, Lab *lab, const Path *x, uint64_t n, Rng *rng)
{
    const Path *y = &lab->proposal;
    double seen[BINS] = { 0 }, expected[BINS] = { 0 }, turned_seen[BINS] = { 0 }, turned_expected[BINS] = { 0 };
    int turned = 0, m = caustic_suffix(x), d = x->k - 1;
    if (row == CHAIN || row == MANIFOLD) chain_suffix(x, &turned);
    if (row == MANIFOLD) turned--;             /* the last one is searched for */
    while (turned > 0 && path_sharp(x, d)) d--;             /* the first vertex at which a direction is turned */
    for (uint64_t i = 0; i < n; i++) {
        propose_anew(row, lab, x, rng);
        if (row == CAUSTIC) {
            Vec3 old = x->v[m].to_lens, w = y->v[m].to_lens;
            seen[angle(old, w) > 0 ? turn_bin(lab, old, w) : BINS - 1]++;
            expected[reference_turn(lab, &x->v[m].point, old, rng)]++;
            continue;
        }
        const Vertex *look = &y->v[y->k - 1];
        seen[look->inv_G > 0 ? film_bin(lab, row, x, &y->v[y->k].point, neg(look->to_lens)) : BINS - 1]++;
        expected[reference_film(lab, row, x, rng)]++;
        if (turned == 0 || !(y->v[d].inv_G > 0) || material_is_specular(y->v[d].point.surface.material)) continue;
        Vec3 old = neg(x->v[d - 1].to_lens);
        turned_seen[y->v[d - 1].inv_G > 0 ? turn_bin(lab, old, neg(y->v[d - 1].to_lens)) : BINS - 1]++;
        turned_expected[reference_turn(lab, &y->v[d].point, old, rng)]++;
    }
    add_chi_squared(f, seen, expected, BINS, false);
    add_chi_squared(f, turned_seen, turned_expected, BINS, false);
}

/* ---- is anything gained? ----
 *
 * Starts follow f* exactly (a bidirectional sample is kept with a probability in proportion to its weight). A row in detailed balance lets as much
 * flow from any set of paths to any other as back, so over paths whose start weight is below a cap, which bounds every term of the sum,
 *     sum over starts and recorded states of weight ( g(state) - g(start) )     has expectation 0 for every function g of a path. */

static void collect(void *context, const Candidate *c)
{
    Lab *lab = context;
    lab->octave[bin(log2(c->weight), -100, 0.25, OCTAVE_BINS)] += c->weight;
    if (c->weight > lab->cap || lab->candidates == ALL) return;
    lab->candidate[lab->candidates++] = *c;
    lab->weight_sum += c->weight;
}

static void sample_candidates(Lab *lab, Rng *rng)
{
    const Camera *camera = &lab->space->scene->camera;
    double px = rng_double(rng) * camera->width, py = rng_double(rng) * camera->height;
    lab->candidates = 0;
    lab->weight_sum = 0;
    bdpt_sample(lab->bdpt, lab->space, px, py, ONE_WAY, NULL, rng, collect, lab);
}

/* The largest cap with which one of KEEP samples still makes a start. */
static void choose_cap(Lab *lab, uint64_t n, Rng *rng)
{
    double below = 0, cap = INFINITY;
    lab->cap = INFINITY;
    for (uint64_t i = 0; i < n; i++) sample_candidates(lab, rng);
    for (int i = 0; i < OCTAVE_BINS; i++) {
        double above = exp2(-100 + 0.25 * (i + 1));
        below += lab->octave[i];
        if (below * KEEP >= above * (double)n) cap = above;
    }
    lab->cap = cap;
}

/* length x pattern at the lens x quarter of the film; pattern x probability of its modes; specular vertices x length of the edge at the lens */
static void add_flow(Lab *lab, const Path *x, double weight)
{
    const Camera *camera = &lab->space->scene->camera;
    unsigned pattern = lens_pattern(x), specular = 0, quarter = (x->raster_x * 2 > camera->width) + 2u * (x->raster_y * 2 > camera->height);
    double q = 1;
    for (int i = 1; i < x->k; i++)
        if (path_specular(x, i)) { specular += specular < 3; q *= x->v[i].s.q; }
    const unsigned class[FAMILIES] = {
        ((unsigned)(x->k < 7 ? x->k : 7) * 64 + pattern) * 4 + quarter,
        FAMILY + pattern * 4 + bin(log(q), -3, 1, 4),
        2 * FAMILY + specular * 64 + bin(log2(length(sub(x->v[x->k].point.p, x->v[x->k - 1].point.p))), -5, 0.125, 64),
    };
    for (int i = 0; i < FAMILIES; i++) lab->flow[lab->touched[lab->n_touched++] = class[i]] += weight;
}

static void record_flow(void *context, const Path *x, double weight)
{
    Lab *lab = context;
    if (!(start_weight(x) <= lab->cap)) return;
    add_flow(lab, x, weight);
    lab->recorded += weight;
}

/* Runs row r alone from lab->start, which stands for paths of weight W, and adds what flowed. */
static void audit_flow(Finding *f, int r, Lab *lab, double W, Rng *rng)
{
    Sampler alone = *lab->sampler;
    ChainCount count = { .steps = 0 };
    for (int other = 0; other < alone.rows; other++) alone.share[other] = other == r;
    path_copy(&lab->x, &lab->start);
    lab->n_touched = 0;
    lab->recorded = 0;
    chain_run(lab->space, &alone, &lab->x, &lab->y, FLOW_STEPS, rng, record_flow, lab, &count);
    add_flow(lab, &lab->start, -lab->recorded);
    for (int j = 0; j < lab->n_touched; j++) {
        unsigned k = lab->touched[j];
        double moved = W * lab->flow[k];
        lab->flow[k] = 0;
        f->sum[k] += moved;
        f->square[k] += moved * moved;
        f->largest[k] = fmax(f->largest[k], moved * moved);
    }
}

/* Returns the worst relative difference between a start's weight and the sampler's. */
static double audit_flows(Lab *lab, uint64_t n, uint64_t seed)
{
    Rng rng = rng_new(seed, (uint64_t)3 << 40);
    double worst = 0;
    choose_cap(lab, n, &rng);
    for (uint64_t i = 0, starts = 0; i < KEEP * n && starts < n; i++) {
        sample_candidates(lab, &rng);
        if (rng_double(&rng) * lab->cap >= lab->weight_sum) continue;
        double W = larger(lab->weight_sum, lab->cap), left = rng_double(&rng) * lab->weight_sum;
        const Candidate *c = lab->candidate, *last = c + lab->candidates - 1;
        while (c < last && left >= c->weight) left -= c++->weight;
        if (!bdpt_path(lab->bdpt, lab->space, c->n_light, c->n_lens, &lab->start)) { worst = INFINITY; continue; }
        worst = fmax(worst, fabs(start_weight(&lab->start) / c->weight - 1));
        starts++;
        for (int r = 0; r < lab->sampler->rows; r++)
            if (is_audited(lab, r) && lab->sampler->table[r].applies(lab->space, &lab->start)) audit_flow(&lab->finding[r], r, lab, W, &rng);
    }
    for (int r = 0; r < lab->sampler->rows; r++)
        for (int k = 0; k < FAMILY * FAMILIES; k++) {
            Finding *f = &lab->finding[r];
            if (!(f->square[k] > ENOUGH * f->largest[k])) continue;        /* too few for a sum to be normal */
            f->z_flow = fmax(f->z_flow, fabs(f->sum[k]) / sqrt(f->square[k]));
            f->classes++;
        }
    return worst;
}

/* ---- all of it ---- */

static void record_nothing(void *context, const Path *path, double weight) { (void)context, (void)path, (void)weight; }

/* Every row proposes from every state of a chain that uses them all; now and then the same state serves for a histogram. */
static void audit_states(Lab *lab, uint64_t n, uint64_t seed)
{
    Rng rng = rng_new(seed, (uint64_t)2 << 40);
    const Space *space = lab->space;
    for (uint64_t step = 0; step < n; step++) {
        if (step % AGAIN == 0 && !bootstrap_seed(lab->seeds, space, lab->bdpt, rng_double(&rng), &lab->x)) return;
        ChainCount count = { .steps = 0 };
        chain_run(space, lab->sampler, &lab->x, &lab->y, 1, &rng, record_nothing, NULL, &count);
        for (int r = 0; r < lab->sampler->rows; r++) {
            Finding *f = &lab->finding[r];
            const Mutation *row = &lab->sampler->table[r];
            const Path *x = &lab->x, *y = &lab->proposal;
            if (!is_audited(lab, r) || !row->applies(space, x)) continue;
            Move move;
            Outcome outcome = row->propose(space, &lab->sampler->tuning, x, &lab->proposal, &rng, &move);
            f->proposals++;
            if (outcome == PROPOSED) {
                f->worst = fmax(f->worst, difference_of_R(r, lab, x, y, &move));
                if (isinf(move.R_xy)) outcome = ZERO_NO_WAY;
                else if (move.joined >= 0 && !scene_visible(space->scene, &y->v[move.joined].point, &y->v[move.joined + 1].point)) outcome = ZERO_BLOCKED;
                else f->accepted += rng_double(&rng) * move.R_xy < move.R_yx && row->applies(space, y);
            }
            f->outcome[outcome]++;
            if (step % AGAIN != 1 || f->states == STATES) continue;
            f->states++;
            if (r == BIDIR) audit_labels(f, lab, x, n / STATES, &rng);
            else audit_steps(f, r, lab, x, n / STATES, &rng);
        }
    }
}

/* False if anything is off. */
static bool print_findings(FILE *out, const Lab *lab, double start_error)
{
    int flows = 0, histograms = 0;
    bool ok = start_error <= worst_allowed;
    for (int r = 0; r < lab->sampler->rows; r++) {
        flows += lab->finding[r].classes;
        histograms += lab->finding[r].freedom > 0;
    }
    double flow_limit = chance_limit(flows, false_alarm / 2), histogram_limit = chance_limit(histograms, false_alarm / 2);
    fprintf(out, "Audit of each strategy: R of every proposal against f/T evaluated whole and from scratch (relative difference, at most %.0e, manifold %.0e),\n"
            "proposals from fixed x against T (z at most %.2f), and flows between classes of paths from exact starts (z at most %.2f).\n\n"
            "%-8s %10s %10s %10s %12s %10s %8s %10s %8s   zero because\n", worst_allowed, worst_spread, histogram_limit, flow_limit,
            "strategy", "proposals", "zero", "accepted", "difference", "proposals", "", "flows", "");
    fprintf(out, "%-8s %10s %10s %10s %12s %10s %8s %10s %8s\n", "", "", "", "", "worst of R", "freedom", "z", "classes", "z");
    for (int r = 0; r < lab->sampler->rows; r++) {
        const Finding *f = &lab->finding[r];
        if (!is_audited(lab, r)) continue;
        double z = f->freedom ? deviate(f->chi_squared, f->freedom) : 0;
        bool good = f->worst <= (r == MANIFOLD ? worst_spread : worst_allowed) && fabs(z) <= histogram_limit && f->z_flow <= flow_limit;
        fprintf(out, "%-8s %10" PRIu64 " %10" PRIu64 " %10" PRIu64 " %12.2e %10d %8.2f %10d %8.2f  ", lab->sampler->table[r].name, f->proposals,
                f->proposals - f->outcome[PROPOSED], f->accepted, f->worst, f->freedom, z, f->classes, f->z_flow);
        for (int i = PROPOSED + 1; i < OUTCOMES; i++)
            if (f->outcome[i]) fprintf(out, " %s %" PRIu64, outcome_name[i], f->outcome[i]);
        if (f->proposals == 0) fputs(" nothing proposed: no path that it applies to was met", out);
        else if (f->freedom == 0 || f->classes == 0)
            fprintf(out, "   too few to test: %s", f->freedom ? "flows" : f->classes ? "proposals from fixed x" : "proposals from fixed x, flows");
        fputs(good ? "\n" : "   OFF\n", out);
        ok &= good;
    }
    fprintf(out, "\nStart weights by a second route: worst relative difference %.2e%s\n", start_error, start_error <= worst_allowed ? "" : "   OFF");
    return ok;
}

bool audit(const Space *space, const Sampler *sampler, int only, const Bootstrap *seeds, Bdpt *bdpt, uint64_t proposals, uint64_t seed, FILE *out,
           Report *report)
{
    Lab *lab = calloc(1, sizeof *lab);
    if (!lab) return report_error(report, NULL, 0, "out of memory");
    lab->space = space;
    lab->sampler = sampler;
    lab->only = only;
    lab->seeds = seeds;
    lab->bdpt = bdpt;
    audit_states(lab, proposals, seed);
    bool ok = print_findings(out, lab, audit_flows(lab, proposals, seed));
    free(lab);
    return ok || report_error(report, NULL, 0, "the audit found something off");
}
