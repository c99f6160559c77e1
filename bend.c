/* See bend.h. */
#include "bend.h"
#include <string.h>

enum {
    MOST_GUESSES = 1 << 12,                    /* where chance brings what is missing */
    MOST_ALONE = 1 << 20,                      /* where nothing does */
    LEAST_TIMES = 4                            /* that a find may count, however well chance does */
};

/* What a way from v[d] carries to the direction 'known', all but 'times'. *searched is the chance with which it is followed up. False if it is nothing. */
static bool carry_to_lamp(const Scene *scene, Vertex *v, int d, Vec3 known, Bent *out, double *searched)
{
    const Material *lamp = v[0].point.surface.material;
    Scatter s;
    double modes = 1, guessed = 1;
    for (int i = d - 1; i >= 0; i--) v[i].to_lens = normalize(sub(v[i + 1].point.p, v[i].point.p));
    Vec3 w = neg(v[d - 1].to_lens);
    if (!material_emits(lamp) || dot(v[0].to_lens, v[0].point.surface.ng) <= 0 || !bsdf_scatter(&v[d].point.surface, w, known, MODE_NONE, &s)) return false;
    double cosine = fabs(dot(w, v[d].point.surface.ng)), pdf_w = s.inv_S_light / s.inv_F * cosine;
    Rgb rgb = scale(cosine / s.inv_F, mul(lamp->ke, s.colour));
    for (int i = d - 1; i > 0; i--) {
        if (!bsdf_scatter(&v[i].point.surface, neg(v[i - 1].to_lens), v[i].to_lens, v[i].mode, &s)) return false;
        rgb = mul(rgb, scale(s.q / s.inv_S_light, s.colour));
        modes *= s.q;
        guessed *= specular_guess_q(s.q);
    }
    SpecularWay way = specular_way(scene, v, d);
    SpecularChance chance = specular_chance(&way, pdf_w * guessed);
    *searched = chance.searched;
    *out = (Bent){ d, scale(way.spread, rgb), pdf_w * modes * way.spread, chance.nominal * scene_light_pdf_a(scene, lamp), chance.nominal };
    return isfinite(way.spread);
}

/* A target is a point of a lamp, or of the lens, which is no surface: a line may go on behind it. */
static bool is_lens(const Point *target) { return target->triangle == BVH_NONE; }
/* Whether the line from a point in direction w to a hit (NULL: none) passes the plane of the lens from its front. */
static bool passes_lens(const Point *lens, const Point *from, Vec3 w, const Point *hit)
{
    Vec3 ng = lens->surface.ng;
    return dot(sub(from->p, lens->p), ng) > 0 && (hit ? dot(sub(hit->p, lens->p), ng) : dot(w, ng)) < 0;
}

/* The straight line from v to the target: sets passage[] and returns d, the edges of a way that refracts wherever the line passes a surface; 0 if there is no such. */
static int straight(const Scene *scene, const Point *from, const Point *target, Passage passage[])
{
    Vec3 w = normalize(sub(target->p, from->p));
    Point at[2] = { *from };
    if (dot(w, target->surface.ng) >= 0) return 0;
    for (int n = 0; n <= MOST_SPECULAR; n++) {
        Point *hit = &at[(n + 1) % 2];
        bool met = scene_trace(scene, &at[n % 2], w, hit);
        if (is_lens(target) ? passes_lens(target, &at[n % 2], w, met ? hit : NULL) : met && hit->triangle == target->triangle) return n > 0 ? n + 1 : 0;
        if (!met || hit->surface.material->kind != MATERIAL_GLASS) return 0;
        passage[n + 1] = (Passage){ .mode = MODE_REFRACT };
    }
    return 0;
}

/* A direction in which the surface scatters, and the modes of the specular vertices that a walk meets from there: the same of d. passage[d - 1] is the first.
 * Where the walk passes the lens and more specular vertices follow behind it, it ends there or goes on, as likely. */
static int guess(const Scene *scene, const Point *from, Vec3 known, const Point *target, Rng *rng, Vec3 *first, Passage passage[])
{
    Mode drawn[MOST_SPECULAR], none;
    Point at[2] = { *from };
    Vec3 w;
    int n = 0;
    if (!bsdf_sample(&from->surface, known, rng, first, &none)) return 0;
    for (w = *first; ; n++) {
        Point *hit = &at[(n + 1) % 2];
        if (!scene_trace(scene, &at[n % 2], w, hit) || !material_is_specular(hit->surface.material)) break;
        if (n > 0 && is_lens(target) && passes_lens(target, &at[n % 2], w, hit) && rng_double(rng) < 0.5) break;
        if (n == MOST_SPECULAR) return 0;
        Vec3 back = neg(w), other_w;
        if (!bsdf_sample(&hit->surface, back, rng, &w, &drawn[n])) return 0;
        Mode other = drawn[n] == MODE_REFLECT ? MODE_REFRACT : MODE_REFLECT;
        if (rng_double(rng) < SPECULAR_EITHER / 2 && bsdf_follow(&hit->surface, back, other, &other_w)) {
            w = other_w;
            drawn[n] = other;
        }
    }
    for (int i = 0; i < n; i++) passage[n - i] = (Passage){ .mode = drawn[i] };
    return n > 0 ? n + 1 : 0;
}

static bool same(const Vertex *a, const Vertex *b, int d)
{
    if (!specular_near(a, b, d, SPECULAR_SAME)) return false;
    for (int i = 1; i < d; i++)
        if (a[i].mode != b[i].mode) return false;
    return true;
}

/* Guesses until one leads to the way v[d] .. v[0], in the direction 'known'; more than 'most' if none of so many does. */
static double count_guesses(const Scene *scene, const Vertex *v, int d, Vec3 known, const Point *target, double most, Rng *rng)
{
    Vertex again[MOST_SPECULAR + 2];
    Passage passage[MOST_SPECULAR + 2];
    Vec3 w;
    again[d].point = v[d].point;
    for (double guesses = 1; guesses <= most; guesses++) {
        if (guess(scene, &v[d].point, known, target, rng, &w, passage) != d) continue;
        bool as_here = true;
        for (int i = 1; i < d; i++) as_here = as_here && passage[i].mode == v[i].mode;
        if (as_here && specular_search(scene, passage, again, d, w, target) && same(again, v, d)) return guesses;
    }
    return most + 1;
}

/* So many guesses are enough: with one more, what was found would count more often than what is met by chance. Nothing is lost by that (bend_left), nor by
 * a bound of the work. */
static double enough_guesses(const Bent *bent, double searched)
{
    if (!(bent->chance_pdf_a > 0)) return MOST_ALONE;
    double times = fmax(LEAST_TIMES, 1 + bent->pdf_a / bent->chance_pdf_a);
    return fmin(ceil(times * searched / bent->times), MOST_GUESSES);
}

/* The way that is found from the straight line to the target; 0 if there is none. */
static int bend_straight(const Scene *scene, const Point *from, const Point *target, int most, Vertex *v)
{
    Passage passage[MOST_SPECULAR + 2];
    int d = straight(scene, from, target, passage);
    if (d == 0 || d > most) return 0;
    v[d].point = *from;
    return specular_search(scene, passage, v, d, normalize(sub(target->p, from->p)), target) ? d : 0;
}

/* The ways to a target, each handed on if 'carry' says that it carries anything. */
typedef bool Carry(const Scene *scene, Vertex *v, int d, Vec3 known, Bent *out, double *searched);
static void bend(const Scene *scene, Vertex *at, int most, Vec3 known, const Point *target, Rng *rng, Carry *carry,
                 void (*found)(void *, const Bent *), void *context)
{
    Vertex direct[MOST_SPECULAR + 2];
    Passage passage[MOST_SPECULAR + 2];
    Bent bent;
    Vec3 w;
    double searched;
    int d_direct = bend_straight(scene, &at->point, target, most, direct);
    if (d_direct > 0) {
        memcpy(at - d_direct, direct, (size_t)d_direct * sizeof *direct);
        if (carry(scene, at - d_direct, d_direct, known, &bent, &searched)) found(context, &bent);
    }
    int d = guess(scene, &at->point, known, target, rng, &w, passage);
    if (d == 0 || d > most) return;
    Vertex *v = at - d;
    if (!specular_search(scene, passage, v, d, w, target) || (d_direct == d && same(direct, v, d))) return;
    if (!carry(scene, v, d, known, &bent, &searched) || rng_double(rng) >= searched) return;
    double enough = enough_guesses(&bent, searched), guesses = count_guesses(scene, v, d, known, target, enough, rng);
    bent.times *= (guesses <= enough ? guesses : bent.chance_pdf_a > 0 ? enough : NAN /* counted as a bad sample */) / searched;
    found(context, &bent);
}

BendLeft bend_left(const Scene *scene, Vertex *v, int edges, Rng *rng)
{
    Vertex direct[MOST_SPECULAR + 2];
    int d = 1;
    Bent bent;
    double searched;
    while (d < edges && v[d].mode != MODE_NONE) d++;
    Vec3 known = normalize(sub(v[d + 1].point.p, v[d].point.p));
    if (d >= edges || !specular_sought(&v[0].point, d) || !carry_to_lamp(scene, v, d, known, &bent, &searched)) return (BendLeft){ 1, 1 };
    const Point lamp = v[0].point;
    BendLeft left = { bent.chance_pdf_a / (bent.chance_pdf_a + bent.pdf_a), 1 };
    double more = bent.pdf_a / bent.chance_pdf_a, looked = fmin(more, 1);      /* where it is little it is roulette whether to look */
    if (rng_double(rng) >= looked || (bend_straight(scene, &v[d].point, &lamp, d, direct) == d && same(direct, v, d))) return left;
    double enough = enough_guesses(&bent, searched);
    if (count_guesses(scene, v, d, known, &lamp, enough, rng) > enough) left.times = 1 + more / looked;
    return left;
}

void bend_walk(const Scene *scene, Vertex *at, int most, Vec3 known, const double light[3], Rng *rng, void (*found)(void *, const Bent *), void *context)
{
    Point lamp;
    scene_sample_light(scene, light, &lamp);
    if (specular_sought(&lamp, 2)) bend(scene, at, most, known, &lamp, rng, carry_to_lamp, found, context);
}

/* The same towards the lens: 'times' is all that is asked for. */
static bool carry_to_lens(const Scene *scene, Vertex *v, int d, Vec3 known, Bent *out, double *searched)
{
    Scatter s;
    double x, y, we, guessed = 1;
    for (int i = d - 1; i >= 0; i--) v[i].to_lens = normalize(sub(v[i + 1].point.p, v[i].point.p));
    Vec3 w = neg(v[d - 1].to_lens);
    if (!camera_project(&scene->camera, &v[0].point, v[0].to_lens, &x, &y, &we) || !bsdf_scatter(&v[d].point.surface, known, w, MODE_NONE, &s)) return false;
    double pdf_w = s.inv_S_lens / s.inv_F * fabs(dot(w, v[d].point.surface.ng));
    for (int i = d - 1; i > 0; i--) {
        if (!bsdf_scatter(&v[i].point.surface, v[i].to_lens, neg(v[i - 1].to_lens), v[i].mode, &s)) return false;
        guessed *= specular_guess_q(s.q);
    }
    SpecularWay way = specular_way(scene, v, d);
    SpecularChance chance = specular_chance(&way, pdf_w * guessed);
    *searched = chance.searched;
    *out = (Bent){ .d = d, .chance_pdf_a = 0, .times = chance.nominal };
    return isfinite(way.spread);
}

/* A walk from a lamp that has arrived at v[m] of its path, way[d]. */
typedef struct { const Space *space; Path *x; int m; const Vertex *at; void (*found)(void *, double); void *context; } FromLight;
static void complete(void *context, const Bent *bent)
{
    const FromLight *f = context;
    Path *x = f->x;
    x->k = f->m + bent->d;
    for (int i = 1; i <= bent->d; i++) {
        x->v[f->m + i].point = f->at[-i].point;
        x->v[f->m + i].mode = f->at[-i].mode;
    }
    x->v[f->m].mode = MODE_NONE;
    if (path_evaluate(f->space, x)) f->found(f->context, bent->times);
}

void bend_from_light(const Space *space, Path *x, Rng *rng, void (*found)(void *, double), void *context)
{
    const Scene *scene = space->scene;
    Vertex way[MOST_SPECULAR + 2], *at = way + MOST_SPECULAR + 1;
    path_grow_to_lens(space, x, -1, rng);
    for (int i = 0; i < space->max_depth - 2; i++) {
        if (i > 0 && rng_double(rng) >= path_survival(&x->v[i].point)) return;
        if (!(i > 0 ? path_grow_to_lens(space, x, i, rng) : path_leave_lamp(space, x, rng))) return;
        if (material_is_specular(x->v[i + 1].point.surface.material)) continue;
        if (x->v[i].mode == MODE_NONE) return;             /* this edge could be joined */
        Point lens;
        FromLight from = { space, x, i + 1, at, found, context };
        int most = space->max_depth - from.m;
        at->point = x->v[i + 1].point;
        camera_sample_lens(&scene->camera, rng, &lens);
        bend(scene, at, most < MOST_SPECULAR + 1 ? most : MOST_SPECULAR + 1, neg(x->v[i].to_lens), &lens, rng, carry_to_lens, complete, &from);
    }
}

double bend_density(const Space *space, const Path *x)
{
    int m = x->k - 1, d;
    while (m > 0 && path_specular(x, m)) m--;
    d = x->k - m;
    if (d < 2 || d - 1 > MOST_SPECULAR) return 0;
    Vertex way[MOST_SPECULAR + 2];
    for (int j = 0; j <= d; j++) {
        way[j].point = x->v[x->k - j].point;
        way[j].mode = x->v[x->k - j].mode;
        if (j < d) way[j].to_lens = neg(x->v[x->k - j - 1].to_lens);
    }
    SpecularWay to_lens = specular_way(space->scene, way, d);
    const Scatter *s = &x->v[m].s;
    double cosine = fabs(dot(x->v[m].to_lens, x->v[m].point.surface.ng)), pdf_w = s->inv_S_lens / s->inv_F * cosine, guessed = 1;
    double density = s->inv_F * x->v[x->k].s.inv_F / (cosine * to_lens.spread);
    for (int i = -1; i < m; i++) density *= path_inv_S_lens(x, i);
    if (m > 0) density *= path_emission_ratio(space, &x->v[0].point, x->v[0].to_lens);
    for (int i = 1; i < m; i++) density *= path_survival(&x->v[i].point);
    for (int i = m + 1; i < x->k; i++) {
        density *= x->v[i].s.inv_S_lens / x->v[i].s.q;
        guessed *= specular_guess_q(x->v[i].s.q);
    }
    return density * specular_chance(&to_lens, pdf_w * guessed).nominal;
}
