/* See bend.h. */
#include "bend.h"
#include <string.h>

enum { MOST_GUESSES = 1 << 20 };               /* until a way is found again */

/* What a way from v[d] carries to the direction 'known', all but 'times'. *searched is the chance with which it is followed up. False if it is nothing. */
static bool carry(const Scene *scene, Vertex *v, int d, Vec3 known, Bent *out, double *searched)
{
    const Material *lamp = v[0].point.surface.material;
    Scatter s;
    double modes = 1;
    for (int i = d - 1; i >= 0; i--) v[i].to_lens = normalize(sub(v[i + 1].point.p, v[i].point.p));
    Vec3 w = neg(v[d - 1].to_lens);
    if (!material_emits(lamp) || dot(v[0].to_lens, v[0].point.surface.ng) <= 0 || !bsdf_scatter(&v[d].point.surface, w, known, MODE_NONE, &s)) return false;
    double cosine = fabs(dot(w, v[d].point.surface.ng)), pdf_w = s.inv_S_light / s.inv_F * cosine;
    Rgb rgb = scale(cosine / s.inv_F, mul(lamp->ke, s.colour));
    for (int i = d - 1; i > 0; i--) {
        if (!bsdf_scatter(&v[i].point.surface, neg(v[i - 1].to_lens), v[i].to_lens, v[i].mode, &s)) return false;
        rgb = mul(rgb, scale(s.q / s.inv_S_light, s.colour));
        modes *= s.q;
    }
    SpecularWay way = specular_way(scene, v, d);
    SpecularChance chance = specular_chance(&way, pdf_w * modes);
    *searched = chance.searched;
    *out = (Bent){ d, scale(way.spread, rgb), pdf_w * modes * way.spread, chance.nominal * scene_light_pdf_a(scene, lamp), chance.nominal };
    return isfinite(way.spread);
}

double bend_share_left(const Scene *scene, Vertex *v, int edges)
{
    int d = 1;
    Bent bent;
    double searched;
    while (d < edges && v[d].mode != MODE_NONE) d++;
    if (d >= edges || !specular_sought(&v[0].point, d) || !carry(scene, v, d, normalize(sub(v[d + 1].point.p, v[d].point.p)), &bent, &searched)) return 1;
    return bent.chance_pdf_a / (bent.chance_pdf_a + bent.pdf_a);
}

/* The straight line from v to the target: sets mode[] and returns d, the edges of a way that refracts wherever the line passes a surface; 0 if there is no such. */
static int straight(const Scene *scene, const Point *from, const Point *target, Mode mode[])
{
    Vec3 w = normalize(sub(target->p, from->p));
    Point at[2] = { *from };
    if (dot(w, target->surface.ng) >= 0) return 0;
    for (int n = 0; n <= MOST_SPECULAR; n++) {
        Point *hit = &at[(n + 1) % 2];
        if (!scene_trace(scene, &at[n % 2], w, hit)) return 0;
        if (hit->triangle == target->triangle) return n > 0 ? n + 1 : 0;
        if (hit->surface.material->kind != MATERIAL_GLASS) return 0;
        mode[n + 1] = MODE_REFRACT;
    }
    return 0;
}

/* A direction in which the surface scatters, and the modes of the specular vertices that a walk meets from there: the same of d. mode[d - 1] is the first. */
static int guess(const Scene *scene, const Point *from, Vec3 known, Rng *rng, Vec3 *first, Mode mode[])
{
    Mode drawn[MOST_SPECULAR], none;
    Point at[2] = { *from };
    Vec3 w;
    int n = 0;
    if (!bsdf_sample(&from->surface, known, rng, first, &none)) return 0;
    for (w = *first; ; n++) {
        Point *hit = &at[(n + 1) % 2];
        if (!scene_trace(scene, &at[n % 2], w, hit) || !material_is_specular(hit->surface.material)) break;
        if (n == MOST_SPECULAR) return 0;
        Vec3 back = neg(w);
        if (!bsdf_sample(&hit->surface, back, rng, &w, &drawn[n])) return 0;
    }
    for (int i = 0; i < n; i++) mode[n - i] = drawn[i];
    return n > 0 ? n + 1 : 0;
}

static bool same(const Vertex *a, const Vertex *b, int d)
{
    if (!specular_near(a, b, d, SPECULAR_SAME)) return false;
    for (int i = 1; i < d; i++)
        if (a[i].mode != b[i].mode) return false;
    return true;
}

void bend_walk(const Scene *scene, Vertex *at, int most, Vec3 known, const double light[3], Rng *rng, void (*found)(void *, const Bent *), void *context)
{
    Point lamp;
    Vertex direct[MOST_SPECULAR + 2], again[MOST_SPECULAR + 2];     /* the way from the straight line; found again */
    Mode mode[MOST_SPECULAR + 2], other[MOST_SPECULAR + 2];
    Bent bent;
    Vec3 w;
    double searched;
    scene_sample_light(scene, light, &lamp);
    if (!specular_sought(&lamp, 2)) return;
    int d_direct = straight(scene, &at->point, &lamp, mode);
    if (d_direct > 0 && d_direct <= most) {
        Vertex *v = at - d_direct;
        if (!specular_search(scene, mode, v, d_direct, normalize(sub(lamp.p, at->point.p)), &lamp)) d_direct = 0;
        else {
            memcpy(direct, v, (size_t)d_direct * sizeof *v);
            if (carry(scene, v, d_direct, known, &bent, &searched)) found(context, &bent);
        }
    }
    int d = guess(scene, &at->point, known, rng, &w, mode);
    if (d == 0 || d > most) return;
    Vertex *v = at - d;
    if (!specular_search(scene, mode, v, d, w, &lamp) || (d_direct == d && same(direct, v, d))) return;
    if (!carry(scene, v, d, known, &bent, &searched) || rng_double(rng) >= searched) return;
    double guesses = 0;
    again[d].point = at->point;
    for (bool back = false; !back; ) {
        if (++guesses > MOST_GUESSES) { guesses = NAN; break; }    /* counted as a bad sample */
        back = guess(scene, &at->point, known, rng, &w, other) == d && memcmp(other + 1, mode + 1, (size_t)(d - 1) * sizeof *mode) == 0
            && specular_search(scene, mode, again, d, w, &lamp) && same(again, v, d);
    }
    bent.times *= guesses / searched;
    found(context, &bent);
}
