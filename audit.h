/* The audit: whether the mutations are right on the scene at hand. Of each row of the sampler's table it asks
 *
 *   is R = f/T?              R(y|x) and R(x|y) of every proposal against f and T evaluated whole and from scratch      [lecture: Back to Mutations]
 *   do proposals follow T?   many from a fixed x, counted, against T or against a second sampler     [Probabilities; Adding Vertices; Pending]
 *   is anything gained?      from exact starts, as much must flow from any set of paths to any other as back       [worked via detailed balance]
 *
 * Each question sees what the others cannot: a T that is wrong in sampling and evaluation alike, a row that applies one way only. Random numbers
 * decide nothing that a false alarm (once in a million audits) could not.
 * Knows no options, and none of the ratios C and S by which the rows reckon: it multiplies densities and G out. */
#ifndef AUDIT_H
#define AUDIT_H
#include "mlt.h"
#include <stdlib.h>

/* Prints a line of findings for each row, or for row 'only' if that is not negative; false with an error if any is off. What had too few proposals to
 * be tested is said, and is not off. The space's image-plane weight must be NULL. */
bool audit(const Space *space, const Sampler *sampler, int only, const Bootstrap *seeds, Bdpt *bdpt, uint64_t proposals, uint64_t seed, FILE *out,
           Report *report);

/* ---- definitions that the audit multiplies and explain.c prints ---- */

enum { BIDIR, LENS, CAUSTIC, CHAIN, SUBPATH, MANIFOLD };      /* rows of mutation_table */

/* Whether the chain may choose row r at x. */
static inline bool may_choose(const Space *space, const Sampler *s, const Path *x, int r) { return s->share[r] > 0 && s->table[r].applies(space, x); }

/* The scalar scattering, at a specular vertex reflectance times (eta_lens/eta_light)^2: S< = F/q there. */
static inline double value_F(const Path *p, int i)
{
    const Scatter *s = &p->v[i].s;
    return path_specular(p, i) ? s->q / s->inv_S_light : 1 / s->inv_F;
}

/* p_d1 and p_a1 before they are cut and normalised again; d = k_a - k_d   [lecture: Probabilities; Probabilities (2)] */
static inline double raw_p_d1(int k_d) { return k_d == 1 ? 0.25 : k_d == 2 ? 0.5 : ldexp(1, -k_d); }
static inline double raw_p_a1(int d) { return d == 0 ? 0.5 : abs(d) == 1 ? 0.15 : 0.1 * ldexp(1, 1 - abs(d)); }

static inline double angle(Vec3 a, Vec3 b) { return atan2(length(cross(a, b)), dot(a, b)); }

/* ---- and what the flows need here and in test/balance.h, where more starts and families of classes go through the same sums ---- */

/* f* over the density of a bidirectional sample, all techniques together, from the path alone: path_routes, where the sampler lets a subpath go on
 * from a vertex with the probability bsdf_albedo. */
static inline double start_weight(const Path *x)
{
    double sum = path_inv_C(x, -1), grown = 1;
    for (int e = 0; e <= x->k; e++) {
        double before = e > 1 ? bsdf_albedo(&x->v[e - 1].point.surface) : 1, after = e + 1 < x->k ? bsdf_albedo(&x->v[e + 1].point.surface) : 1;
        grown *= path_inv_S_lens(x, e - 1) * before;
        sum = sum * path_inv_S_light(x, e + 1) * after + grown * path_inv_C(x, e);
    }
    return x->chi / sum;
}

/* How light passes the three vertices next to the lens: 0 diffuse, 1 reflected, 2 refracted, 3 no vertex; 64 patterns. */
static inline unsigned lens_pattern(const Path *x)
{
    unsigned pattern = 0;
    for (int i = 1; i <= 3; i++) pattern = 4 * pattern + (x->k - i > 0 ? (unsigned)x->v[x->k - i].mode : 3);
    return pattern;
}

/* |z| that one of so many comparisons passes by chance with probability 'alarm' */
static inline double chance_limit(double comparisons, double alarm)
{
    double low = 0, high = 30;
    while (high - low > 1e-6) {
        double z = (low + high) / 2;
        if (comparisons * erfc(z / sqrt(2)) > alarm) low = z;
        else high = z;
    }
    return high;
}
#endif
