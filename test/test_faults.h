/* Planted faults: rows that are wrong as a programmer might get them wrong. Most wrap the real row and spoil its two ratios; those that
 * spoil what a path has cached work on copies. Every statistical test of the rows is shown what it must catch. */
#ifndef TEST_FAULTS_H
#define TEST_FAULTS_H
#include "audit.h"
#include <string.h>

/* Multiplies R(y|x) by g(y) and R(x|y) by g(x). */
static inline Outcome fault_factor(int row, double (*g)(const Space *, const Path *), const Space *space, const Tuning *tuning, const Path *x, Path *y, Rng *rng, Move *move)
{
    Outcome outcome = mutation_table[row].propose(space, tuning, x, y, rng, move);
    if (outcome != PROPOSED) return outcome;
    move->R_yx *= g(space, y);
    move->R_xy *= g(space, x);
    return PROPOSED;
}

/* ---- S of a drawn mode where the mode was copied: 1/q too much at every specular vertex that was retraced ---- */

static inline double inverse_q(const Path *x, int first)
{
    double product = 1;
    for (int i = first; i < x->k; i++)
        if (x->v[i].mode != MODE_NONE) product /= x->v[i].s.q;
    return product;
}
static inline double lens_q(const Space *s, const Path *x) { (void)s; return inverse_q(x, lens_suffix(x) + 1); }
static inline double chain_q(const Space *s, const Path *x) { (void)s; int turned; return inverse_q(x, chain_suffix(x, &turned) + 1); }
static inline double caustic_q(const Space *s, const Path *x) { (void)s; return inverse_q(x, caustic_suffix(x) + 1); }

/* ---- |cos| left out, of turned directions and narrow lobes ---- */

static inline double caustic_cosine(const Space *s, const Path *x)
{
    (void)s;
    double product = 1;
    for (int i = caustic_suffix(x); i < x->k - 1; i++)
        if (x->v[i].mode == MODE_NONE) product /= fabs(dot(x->v[i].to_lens, x->v[i].point.surface.ng));
    return product;
}
static inline double cosines_beyond(const Path *x, int m)
{
    double product = 1;
    for (int i = m + 1; i < x->k; i++)
        if (x->v[i].mode == MODE_NONE) product /= fabs(dot(x->v[i - 1].to_lens, x->v[i].point.surface.ng));
    return product;
}
static inline double lens_cosine(const Space *s, const Path *x) { (void)s; return cosines_beyond(x, lens_suffix(x)); }
static inline double chain_cosine(const Space *s, const Path *x) { (void)s; int turned; return cosines_beyond(x, chain_suffix(x, &turned)); }

/* ---- the solid angle that arrives on an area of the lamp left out: the direction at D taken as if it were given ---- */

static inline double join_of_spread(const Space *s, const Path *x) { return 1 / manifold_spread(s->scene, x, x); }
static inline Outcome manifold_no_spread(const Space *s, const Tuning *t, const Path *x, Path *y, Rng *rng, Move *move)
{
    return fault_factor(MANIFOLD, join_of_spread, s, t, x, y, rng, move);
}

/* ---- the choice of strategy left out of the ratio ---- */

/* For a sampler with all rows of mutation_table at their shares. */
static inline double all_choices(const Space *space, const Path *x)
{
    double sum = 0;
    for (int i = 0; i < MUTATIONS; i++)
        if (mutation_table[i].applies(space, x)) sum += mutation_table[i].share;
    return sum;
}
/* The rows but bidir keep the pattern of specular vertices, on which alone the choice depends: q cancels, and nothing would show. So they are tested
 * beside a row that applies on the film's left half only, which is as right as any: shares of 1 for the row, 1/4 for bidir, 4 for that one. */
static const double left_share = 4, beside_share = 0.25;
static inline bool left_applies(const Space *space, const Path *x) { return 2 * x->raster_x < space->scene->camera.width; }
static inline double left_choices(const Space *space, const Path *x) { return 1 + beside_share + (left_applies(space, x) ? left_share : 0); }

#define FAULT_ROW(name, row, g) \
    static inline Outcome name(const Space *space, const Tuning *tuning, const Path *x, Path *y, Rng *rng, Move *move) \
    { return fault_factor(row, g, space, tuning, x, y, rng, move); }
FAULT_ROW(lens_drawn, LENS, lens_q)
FAULT_ROW(caustic_drawn, CAUSTIC, caustic_q)
FAULT_ROW(chain_drawn, CHAIN, chain_q)
FAULT_ROW(lens_no_cosine, LENS, lens_cosine)
FAULT_ROW(caustic_no_cosine, CAUSTIC, caustic_cosine)
FAULT_ROW(chain_no_cosine, CHAIN, chain_cosine)
FAULT_ROW(bidir_no_choice, BIDIR, all_choices)
FAULT_ROW(lens_no_choice, LENS, left_choices)
FAULT_ROW(caustic_no_choice, CAUSTIC, left_choices)
FAULT_ROW(chain_no_choice, CHAIN, left_choices)
FAULT_ROW(subpath_no_choice, SUBPATH, left_choices)

static inline Outcome seen_drawn(const Space *space, const Tuning *tuning, const Path *x, Path *y, Rng *rng, Move *move)
{
    Outcome outcome = seen_mutation.propose(space, tuning, x, y, rng, move);
    if (outcome != PROPOSED) return outcome;
    move->R_yx *= inverse_q(y, 1);
    move->R_xy *= inverse_q(x, 1);
    return PROPOSED;
}

/* ---- a factor left out of S, as if bsdf_scatter had forgotten it ---- */

/* S<: radiance scales by (eta_lens/eta_light)^2 across an interface */
static inline void spoil_eta(Path *x)
{
    for (int i = 1; i < x->k; i++) {
        Vertex *v = &x->v[i];
        const Material *m = v->point.surface.material;
        if (v->mode != MODE_REFRACT) continue;
        double eta = dot(v[-1].to_lens, v->point.surface.ns) < 0 ? m->ni : 1 / m->ni;    /* beyond over before, seen from the light */
        v->s.inv_S_light *= eta * eta;
    }
}
/* S>: |w_E.n_g| |w_L.n_s| / (|w_L.n_g| |w_E.n_s|) */
static inline void spoil_normals(Path *x)
{
    for (int i = 1; i < x->k; i++) {
        Vertex *v = &x->v[i];
        if (v->mode == MODE_NONE) continue;
        Vec3 light = v[-1].to_lens, lens = v->to_lens, ng = v->point.surface.ng, ns = v->point.surface.ns;
        v->s.inv_S_lens *= fabs(dot(lens, ng) * dot(light, ns) / (dot(light, ng) * dot(lens, ns)));
    }
}

/* The bidirectional row on spoiled copies; y is left as it ought to be, for the next step. */
static inline Outcome fault_cache(void (*spoil)(Path *), const Space *space, const Tuning *tuning, const Path *x, Path *y, Rng *rng, Move *move)
{
    static Path spoiled_x, spoiled_y;              /* the tests have one thread; too large for a stack */
    path_copy(&spoiled_x, x);
    path_finish(space, &spoiled_x);                /* forgets W */
    spoil(&spoiled_x);
    Outcome outcome = bidir_propose(space, tuning, &spoiled_x, y, rng, move);
    if (outcome != PROPOSED) return outcome;
    if (!path_evaluate(space, y)) return ZERO_SIDE;
    path_copy(&spoiled_y, y);
    path_finish(space, &spoiled_y);
    spoil(&spoiled_y);
    double p_d2 = bidir_p_d2(tuning, &spoiled_y, move->s, move->s + move->k_a), routes = path_routes(&spoiled_y, move->s, move->s + move->k_a);
    move->R_yx *= move->routes_y / routes;
    move->R_xy *= move->p_d2_y / p_d2;
    return PROPOSED;
}
static inline Outcome bidir_no_eta(const Space *space, const Tuning *tuning, const Path *x, Path *y, Rng *rng, Move *move)
{
    return fault_cache(spoil_eta, space, tuning, x, y, rng, move);
}
static inline Outcome bidir_no_normals(const Space *space, const Tuning *tuning, const Path *x, Path *y, Rng *rng, Move *move)
{
    return fault_cache(spoil_normals, space, tuning, x, y, rng, move);
}
static inline double caustic_normals(const Space *s, const Path *x)
{
    (void)s;
    double product = 1;
    for (int i = caustic_suffix(x) + 1; i < x->k - 1; i++) {
        Vec3 light = x->v[i - 1].to_lens, lens = x->v[i].to_lens, ng = x->v[i].point.surface.ng, ns = x->v[i].point.surface.ns;
        product *= fabs(dot(light, ng) * dot(lens, ns) / (dot(lens, ng) * dot(light, ns)));   /* S> over what it should be */
    }
    return product;
}
FAULT_ROW(caustic_no_normals, CAUSTIC, caustic_normals)

/* ---- the bidirectional T ---- */

/* 1/Q of one way alone: j vertices grown from v[s]. */
static inline double one_way(const Path *p, int s, int t, int j)
{
    int e = s + j;
    double product = path_inv_C(p, e);
    for (int i = s; i < e; i++) product *= path_inv_S_lens(p, i);
    for (int i = e + 2; i <= t; i++) product *= path_inv_S_light(p, i);
    return product;
}
/* T of the way taken alone, and back the way that has as many vertices from v[s], or all if there are fewer. */
static inline Outcome bidir_one_way(const Space *space, const Tuning *tuning, const Path *x, Path *y, Rng *rng, Move *move)
{
    Outcome outcome = bidir_propose(space, tuning, x, y, rng, move);
    if (outcome != PROPOSED) return outcome;
    double forward = one_way(y, move->s, move->s + move->k_a, move->j);
    double back = one_way(x, move->s, move->t, move->j < move->k_d ? move->j : move->k_d - 1);
    if (!(forward > 0 && back > 0)) return ZERO_NO_WAY;
    move->R_yx *= move->routes_y / forward;
    move->R_xy *= move->routes_x / back;
    return PROPOSED;
}
/* p_a1 as the slides have it, not normalised again where k_max or 1 cuts it */
static inline Outcome bidir_raw_p_a1(const Space *space, const Tuning *tuning, const Path *x, Path *y, Rng *rng, Move *move)
{
    Outcome outcome = bidir_propose(space, tuning, x, y, rng, move);
    if (outcome != PROPOSED) return outcome;
    move->R_yx *= move->p_a1_x / raw_p_a1(move->k_a - move->k_d);
    move->R_xy *= move->p_a1_y / raw_p_a1(move->k_d - move->k_a);
    return PROPOSED;
}
/* p_d1 likewise */
static inline Outcome bidir_raw_p_d1(const Space *space, const Tuning *tuning, const Path *x, Path *y, Rng *rng, Move *move)
{
    Outcome outcome = bidir_propose(space, tuning, x, y, rng, move);
    if (outcome != PROPOSED) return outcome;
    move->R_yx *= move->p_d1_x / raw_p_d1(move->k_d);
    move->R_xy *= move->p_d1_y / raw_p_d1(move->k_a);
    return PROPOSED;
}
/* the importance of the segment in the choice of what to delete left out of the ratio */
static inline Outcome bidir_no_p_d2(const Space *space, const Tuning *tuning, const Path *x, Path *y, Rng *rng, Move *move)
{
    Outcome outcome = bidir_propose(space, tuning, x, y, rng, move);
    if (outcome != PROPOSED) return outcome;
    move->R_yx *= move->p_d2_x;
    move->R_xy *= move->p_d2_y;
    return PROPOSED;
}

/* ---- a = f(y)/f(x): T left out ---- */

/* f*; vertices and edges that both paths share cancel in the ratio. */
static inline double target(const Path *x)
{
    double f = x->chi;
    for (int i = 0; i <= x->k; i++) f *= value_F(x, i) / (i < x->k ? x->v[i].inv_G : 1);
    return f;
}
static inline Outcome f_alone(int row, const Space *space, const Tuning *tuning, const Path *x, Path *y, Rng *rng, Move *move)
{
    Outcome outcome = mutation_table[row].propose(space, tuning, x, y, rng, move);
    if (outcome != PROPOSED) return outcome;
    move->R_yx = target(y);
    move->R_xy = target(x);
    return PROPOSED;
}

/* ---- 'the chain is stuck, so let it go': after TIRED rejections what is proposed is accepted whatever the ratio ---- */

enum { TIRED = 3 };
static inline Outcome forced(int row, const Space *space, const Tuning *tuning, const Path *x, Path *y, Rng *rng, Move *move)
{
    static double stuck_chi, stuck_x, stuck_y;     /* of the path that rejects; there is one chain at a time */
    static int stuck_for;
    bool same = stuck_chi == x->chi && stuck_x == x->raster_x && stuck_y == x->raster_y;
    stuck_for = same ? stuck_for + 1 : 0;
    stuck_chi = x->chi;
    stuck_x = x->raster_x;
    stuck_y = x->raster_y;
    Outcome outcome = mutation_table[row].propose(space, tuning, x, y, rng, move);
    if (outcome == PROPOSED && stuck_for >= TIRED) {
        move->R_yx = 1e12;
        move->R_xy = 1;
    }
    return outcome;
}

#define FAULT_ROWS(fault) \
    static inline Outcome fault##_bidir(const Space *s, const Tuning *t, const Path *x, Path *y, Rng *r, Move *m) { return fault(BIDIR, s, t, x, y, r, m); } \
    static inline Outcome fault##_lens(const Space *s, const Tuning *t, const Path *x, Path *y, Rng *r, Move *m) { return fault(LENS, s, t, x, y, r, m); } \
    static inline Outcome fault##_caustic(const Space *s, const Tuning *t, const Path *x, Path *y, Rng *r, Move *m) { return fault(CAUSTIC, s, t, x, y, r, m); } \
    static inline Outcome fault##_chain(const Space *s, const Tuning *t, const Path *x, Path *y, Rng *r, Move *m) { return fault(CHAIN, s, t, x, y, r, m); } \
    static inline Outcome fault##_subpath(const Space *s, const Tuning *t, const Path *x, Path *y, Rng *r, Move *m) { return fault(SUBPATH, s, t, x, y, r, m); }
FAULT_ROWS(f_alone)
FAULT_ROWS(forced)

/* ---- steps in proportion to the path, and nobody asks whether the way back lies in the range there ---- */

static inline Outcome lens_scaled(const Space *space, const Tuning *tuning, const Path *x, Path *y, Rng *rng, Move *move)
{
    Tuning own = *tuning;
    own.r2 *= 2 * length(sub(x->v[x->k].point.p, x->v[x->k - 1].point.p));
    return mutation_table[LENS].propose(space, &own, x, y, rng, move);
}
static inline Outcome caustic_scaled(const Space *space, const Tuning *tuning, const Path *x, Path *y, Rng *rng, Move *move)
{
    Tuning own = *tuning;
    int m = caustic_suffix(x);
    own.theta2 *= 0.3 / length(sub(x->v[m + 1].point.p, x->v[m].point.p));
    if (own.theta2 > 3) own.theta2 = 3;
    return mutation_table[CAUSTIC].propose(space, &own, x, y, rng, move);
}

/* ---- pixels in a fixed order along a chain: the raster position is the next one of a scan, not independent of the chain's past ---- */

static uint64_t scan_position;                     /* runs through from chain to chain: the first position of each is as good as random */

static inline Outcome subpath_scan(const Space *space, const Tuning *tuning, const Path *x, Path *y, Rng *rng, Move *move)
{
    /* The real row takes lens point, position and modes from one generator. Here the position is put in place of its own: a path that
     * ends at the lens is grown until the row's proposal falls into the pixel that the scan has reached. */
    const Camera *camera = &space->scene->camera;
    uint64_t pixels = (uint64_t)camera->width * camera->height, pixel = scan_position++ % pixels;
    for (int tries = 0; tries < 100000; tries++) {
        Rng ahead = *rng;
        Point lens;
        camera_sample_lens(camera, &ahead, &lens);
        uint32_t column = (uint32_t)(rng_double(&ahead) * camera->width), row = (uint32_t)(rng_double(&ahead) * camera->height);
        if ((uint64_t)row * camera->width + column == pixel) break;
        rng_bits(rng);
    }
    return mutation_table[SUBPATH].propose(space, tuning, x, y, rng, move);
}

/* ---- wrong suffix ---- */

/* The lens subpath row on paths whose suffix is the chain row's, too: it takes the D before a specular chain for the end of the lens subpath,
 * and puts a path there from which nothing leads back. */
static inline bool subpath_wrong_applies(const Space *space, const Path *x)
{
    int turned;
    return chain_suffix(x, &turned) > 0 || mutation_table[SUBPATH].applies(space, x);
}
static inline Outcome subpath_wrong(const Space *space, const Tuning *tuning, const Path *x, Path *y, Rng *rng, Move *move)
{
    static Path shorter;                           /* x without what lies beyond that D */
    int turned, m = chain_suffix(x, &turned);
    path_copy(&shorter, x);
    if (m > 0) {
        shorter.v[m + 1] = x->v[x->k];
        shorter.k = m + 1;
    }
    return mutation_table[SUBPATH].propose(space, tuning, &shorter, y, rng, move);
}

/* The caustic row, starting one non-specular vertex too far towards the light: what is (L|D) S* D S* D E ends at the light, at the middle D
 * the old world direction is used again, and the ratio takes it for specular. */
static inline int too_far(const Path *x)
{
    int m = caustic_suffix(x);
    if (m < 1) return -1;
    for (m--; m > 0 && x->v[m].mode != MODE_NONE; m--) { }
    return m;
}
static inline double taken_for_specular(const Path *y, int m)
{
    double R = caustic_R(y, m);
    for (int i = m + 1; i < y->k - 1; i++) {
        const Vertex *v = &y->v[i];
        if (v->mode == MODE_NONE) R *= v->s.inv_F / fabs(dot(v->to_lens, v->point.surface.ng)) / v->s.inv_S_lens;
    }
    return R;
}
static inline bool caustic_far_applies(const Space *space, const Path *x) { (void)space; return too_far(x) >= 0; }
static inline Outcome caustic_far(const Space *space, const Tuning *tuning, const Path *x, Path *y, Rng *rng, Move *move)
{
    int m = too_far(x), k = x->k;
    path_copy(y, x);
    double theta = tuning->theta2 * exp(tuning->log_theta * rng_double(rng));
    Vec3 w = sample_turned(x->v[m].to_lens, cos(theta), sin(theta), rng);
    for (int i = m; i < k - 1; i++) {
        Vertex *v = &y->v[i];
        if (i > m && v->mode == MODE_NONE) w = x->v[i].to_lens;
        else if (i > m && !bsdf_follow(&v->point.surface, neg(v[-1].to_lens), v->mode, &w)) return ZERO_SIDE;
        if (!scene_trace(space->scene, &v->point, w, &v[1].point) || !path_edge(y, i)) return ZERO_LOST;
        if ((v[1].mode == MODE_NONE) == material_is_specular(v[1].point.surface.material)) return ZERO_SIDE;
    }
    if (!path_edge(y, k - 1)) return ZERO_SIDE;
    for (int i = m; i <= k; i++)
        if (!path_scatter(space, y, i)) return ZERO_SIDE;
    path_finish(space, y);
    if (!(y->chi > 0)) return ZERO_CLASS;
    *move = (Move){ .R_yx = taken_for_specular(y, m), .R_xy = taken_for_specular(x, m), .joined = k - 1, .first = m + 1, .last = k - 1 };
    return PROPOSED;
}
#endif
