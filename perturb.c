/* The other mutations: lens, caustic and multi-chain perturbation, and the lens subpath mutation. [lecture: 'two other mutation strategies';
 * Veach ch. 11.4]
 *
 * Read from the light: L light, D non-specular, S specular, E lens. Two walks do all of it:
 *   towards the light   from a raster position through S (modes copied), at each D that is not the last turned by a small angle, to x_m
 *   towards the lens    from x_m along a turned direction through S (modes copied) to y_{k-1}, joined to the lens
 * In R = f/T the density of each step is the same from x and from y but for what R keeps: at a specular vertex the mode was copied, its
 * probability in T is 1 and not q, so S_copied = q S_drawn; a turned direction has a density per solid angle that depends on the angle alone,
 * so F |cos| stays; a step on the film is symmetric in raster coordinates, where S<_k = 1.
 *
 * A vertex whose light goes by a narrow lobe counts as S, too: to join across it is as hopeless as at a mirror, and to turn a direction loses the
 * lobe. What is copied there is how far, and to which side, light leaves it off the mirror image (bsdf_pass). That is a rotation of the direction, which
 * keeps solid angles, and from y it leads back: so, as where a direction is turned, F |cos| stays, and F is the same at both.
 */
#include "mutate.h"
#include <string.h>

/* Steps of all scales: density 1/(r ln(b/a)) on [a,b]. Symmetric, so it cancels in T(y|x)/T(x|y). */
static double draw_step(double b, double log_a_over_b, Rng *rng) { return b * exp(log_a_over_b * rng_double(rng)); }

static Vec3 turn(Vec3 w, const Tuning *tuning, Rng *rng)
{
    double theta = draw_step(tuning->theta2, tuning->log_theta, rng), sine = sin(theta);
    return normalize(sample_turned(w, theta < PI / 2 ? sqrt(1 - sine * sine) : cos(theta), sine, rng));
}

int lens_suffix(const Path *x)
{
    int i = x->k - 1;
    while (i > 0 && path_sharp(x, i)) i--;
    return i > 0 && !path_specular(x, i - 1) ? i : -1;
}

int chain_suffix(const Path *x, int *turned)
{
    int i = x->k - 1;
    bool lobe = false;
    for (; i > 0 && path_sharp(x, i); i--) lobe |= !path_specular(x, i);
    for (*turned = 0; i > 0 && path_sharp(x, i - 1); ++*turned)    /* D whose neighbour towards the light is S: on to the next D, or the light */
        for (i--; i > 0 && path_sharp(x, i); i--) { }
    return *turned > 0 || (i == 0 && lobe) ? i : -1;
}

int caustic_suffix(const Path *x)
{
    int i = x->k - 1;
    if (i < 1 || path_sharp(x, i)) return -1;
    for (i--; i > 0 && path_sharp(x, i); i--) { }
    return i;
}

double lens_R(const Path *y, int m)
{
    double inverse = path_inv_C(y, m - 1);
    for (int i = m + 1; i < y->k; i++) {
        const Vertex *v = &y->v[i];
        inverse *= path_specular(y, i) ? v->s.inv_S_light / v->s.q : v->s.inv_F / fabs(dot(v[-1].to_lens, v->point.surface.ng));
    }
    return y->chi / inverse;
}

double caustic_R(const Path *y, int m)
{
    double inverse = path_inv_C(y, y->k - 1);
    for (int i = m; i < y->k - 1; i++) {
        const Vertex *v = &y->v[i];
        inverse *= path_specular(y, i) ? v->s.inv_S_lens / v->s.q : v->s.inv_F / fabs(dot(v->to_lens, v->point.surface.ng));
    }
    return y->chi / inverse;
}

bool perturb_alike(const Path *x, const Path *y, int from)
{
    for (int i = from > 0 ? from : 1; i < x->k; i++)
        if (x->v[i].s.narrow != y->v[i].s.narrow) return false;
    return true;
}

Outcome perturb_evaluate(const Space *space, Path *y, int from, int to, int joined)
{
    if (joined >= 0 && !path_edge(y, joined)) return ZERO_SIDE;
    for (int i = to; i >= from; i--)
        if (!path_scatter(space, y, i)) return i == y->k ? ZERO_FILM : ZERO_SIDE;
    path_finish(space, y);
    return y->chi > 0 ? PROPOSED : ZERO_CLASS;
}

static void keep_ends(const Path *x, Path *y, int last_kept)
{
    y->k = x->k;
    y->known = x->known;
    y->light_pdf_a = x->light_pdf_a;
    memcpy(y->v, x->v, (size_t)(last_kept + 1) * sizeof y->v[0]);
    y->v[x->k] = x->v[x->k];
}

Outcome perturb_walk(const Space *space, const Tuning *tuning, const Path *x, Path *y, int m, Rng *rng)
{
    const Camera *camera = &space->scene->camera;
    Vec3 step = sample_turned(vec3(0, 0, 1), 0, draw_step(tuning->r2, tuning->log_r, rng), rng);
    double raster_x = x->raster_x + step.x, raster_y = x->raster_y + step.y;
    if (!(raster_x >= 0 && raster_x < camera->width && raster_y >= 0 && raster_y < camera->height)) return ZERO_FILM;
    keep_ends(x, y, m - 1);
    if (!path_look(space, y, raster_x, raster_y)) return ZERO_LOST;
    for (int i = y->k - 1; i > m; i--) {
        Vertex *v = &y->v[i];
        Vec3 w;
        v->mode = x->v[i].mode;
        if (path_sharp(x, i)) {
            const Passage passage = path_passage(x, i, true);
            if (!bsdf_pass(&v->point.surface, v->to_lens, &passage, &w)) return ZERO_SIDE;
        } else {
            if (material_is_specular(v->point.surface.material)) return ZERO_SIDE;
            w = turn(neg(x->v[i - 1].to_lens), tuning, rng);
        }
        v[-1].mode = MODE_NONE;
        if (!scene_trace(space->scene, &v->point, w, &v[-1].point) || !path_edge(y, i - 1)) return ZERO_LOST;
    }
    return PROPOSED;
}

/* Moves x_m .. x_{k-1}, starting on the film; from x_alike on it matters to the row where narrow lobes are. */
static Outcome walk_to_light(const Space *space, const Tuning *tuning, const Path *x, Path *y, int m, int alike, Rng *rng, Move *move)
{
    Outcome outcome = perturb_walk(space, tuning, x, y, m, rng);
    if (outcome == PROPOSED) outcome = perturb_evaluate(space, y, m > 0 ? m - 1 : 0, y->k, m - 1);
    if (outcome != PROPOSED) return outcome;
    if (!perturb_alike(x, y, alike)) return ZERO_SIDE;
    *move = (Move){ .R_yx = lens_R(y, m), .R_xy = lens_R(x, m), .joined = m - 1, .first = m, .last = x->k - 1 };
    return PROPOSED;
}

static bool lens_applies(const Space *space, const Path *x) { (void)space; return lens_suffix(x) > 0; }

static Outcome lens_propose(const Space *space, const Tuning *tuning, const Path *x, Path *y, Rng *rng, Move *move)
{
    int m = lens_suffix(x);
    return walk_to_light(space, tuning, x, y, m, m, rng, move);
}

static bool chain_applies(const Space *space, const Path *x)
{
    (void)space;
    int turned;
    return chain_suffix(x, &turned) >= 0;
}

static Outcome chain_propose(const Space *space, const Tuning *tuning, const Path *x, Path *y, Rng *rng, Move *move)
{
    int turned, m = chain_suffix(x, &turned);
    return walk_to_light(space, tuning, x, y, m, m - 1, rng, move);
}

/* Not where S* is empty, though it would be right there too: the lens perturbation does that work better. */
static bool caustic_applies(const Space *space, const Path *x)
{
    (void)space;
    return caustic_suffix(x) >= 0 && path_sharp(x, x->k - 2);
}

static Outcome caustic_propose(const Space *space, const Tuning *tuning, const Path *x, Path *y, Rng *rng, Move *move)
{
    int m = caustic_suffix(x), k = x->k;
    keep_ends(x, y, m);
    Vec3 w = turn(x->v[m].to_lens, tuning, rng);
    for (int i = m; i < k - 1; i++) {
        Vertex *v = &y->v[i];
        v->mode = x->v[i].mode;
        if (i > m) {
            const Passage passage = path_passage(x, i, false);
            if (!bsdf_pass(&v->point.surface, neg(v[-1].to_lens), &passage, &w)) return ZERO_SIDE;
        }
        v[1].mode = MODE_NONE;
        if (!scene_trace(space->scene, &v->point, w, &v[1].point) || !path_edge(y, i)) return ZERO_LOST;
    }
    Outcome outcome = perturb_evaluate(space, y, m, k, k - 1);
    if (outcome != PROPOSED) return outcome;
    if (!perturb_alike(x, y, m)) return ZERO_SIDE;
    *move = (Move){ .R_yx = caustic_R(y, m), .R_xy = caustic_R(x, m), .joined = k - 1, .first = m + 1, .last = k - 1 };
    return PROPOSED;
}

/* (L|D) D S* E, S specular: here narrow lobes are as any D. */
static int subpath_suffix(const Path *x)
{
    int i = x->k - 1;
    while (i > 0 && path_specular(x, i)) i--;
    return i > 0 && !path_specular(x, i - 1) ? i : -1;
}

static bool subpath_applies(const Space *space, const Path *x) { (void)space; return subpath_suffix(x) > 0; }

/* R(y|x) of the lens subpath mutation: modes are drawn, so S< is that of a drawn mode, whatever made the path. */
static double subpath_R(const Path *y, int m)
{
    double inverse = path_inv_C(y, m - 1);
    for (int i = m + 1; i < y->k; i++) inverse *= y->v[i].s.inv_S_light;
    return y->chi / inverse;
}

/* A fresh raster position and lens point, independent of the chain's past; the number of specular vertices is free. */
static Outcome subpath_propose(const Space *space, const Tuning *tuning, const Path *x, Path *y, Rng *rng, Move *move)
{
    (void)tuning;
    int m = subpath_suffix(x);
    keep_ends(x, y, m - 1);
    y->k = space->max_depth;                   /* grown at the far end of the array, moved up when the length is known */
    path_grow_to_light(space, y, y->k + 1, rng);
    int i = y->k;
    do {
        if (i == m) return ZERO_CLASS;         /* longer than --max-depth allows */
        if (!path_grow_to_light(space, y, i, rng)) return ZERO_LOST;
        i--;
    } while (material_is_specular(y->v[i].point.surface.material));
    y->k -= i - m;
    memmove(y->v + m, y->v + i, (size_t)(y->k - m + 1) * sizeof y->v[0]);
    Outcome outcome = perturb_evaluate(space, y, m - 1, y->k, m - 1);
    if (outcome != PROPOSED) return outcome;
    *move = (Move){ .R_yx = subpath_R(y, m), .R_xy = subpath_R(x, m), .joined = m - 1, .first = m, .last = x->k - 1 };
    return PROPOSED;
}

const Mutation mutation_table[MUTATIONS] = {
    { "bidir", 1, false, bidir_applies, bidir_propose, STEP_NONE },
    { "lens", 3, false, lens_applies, lens_propose, STEP_FILM },
    { "caustic", 3, true, caustic_applies, caustic_propose, STEP_TURN },
    { "chain", 3, true, chain_applies, chain_propose, STEP_NONE },
    { "subpath", 1, false, subpath_applies, subpath_propose, STEP_NONE },
    { "manifold", 0.3, true, manifold_applies, manifold_propose, STEP_NONE },
};

static bool seen_applies(const Space *space, const Path *x)
{
    (void)space;
    int turned;
    return chain_suffix(x, &turned) < 0 && x->k > 1;
}

static Outcome seen_propose(const Space *space, const Tuning *tuning, const Path *x, Path *y, Rng *rng, Move *move)
{
    return walk_to_light(space, tuning, x, y, 0, 0, rng, move);
}

const Mutation seen_mutation = { "seen", 1, true, seen_applies, seen_propose, STEP_FILM };
