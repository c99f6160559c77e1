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

/* Prints a line of findings for each row; false with an error if any is off. The space's image-plane weight must be NULL. */
bool audit(const Space *space, const Sampler *sampler, const Bootstrap *seeds, Bdpt *bdpt, uint64_t proposals, uint64_t seed, FILE *out, Report *report);

/* ---- definitions that the audit multiplies and explain.c prints ---- */

enum { BIDIR, LENS, CAUSTIC, CHAIN, SUBPATH };                /* rows of mutation_table */

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
#endif
