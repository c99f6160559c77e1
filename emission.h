/* Which way light leaves a lamp that is found to matter: a sun sends most of its light past the window. Light subpaths in search of seeds for chains leave
 * their lamp by the cosine law or, as often, by a density over directions that the chains' paths have taught, in all rounds before. The chains' own
 * mutations know nothing of it, nor do the samples that make the picture. [Jensen 1995: importance driven path tracing using the photon map; Mueller,
 * Gross, Novak 2017: practical path guiding]
 *
 * Each material that emits has a binary tree over the unit square to which the sphere of directions unrolls by area: x = (1 + w.z) / 2, y = phi / 2 pi.
 * Knows no paths. */
#ifndef EMISSION_H
#define EMISSION_H
#include "rng.h"
#include "vec.h"

enum { EMISSION_LAMPS = 16, EMISSION_KEPT = 16384, EMISSION_NODES = 4096 };

/* Of an inner node the halves of its cell, x and y in turn, are node child and child + 1; so much of its mass is in the first. A leaf has child 0. */
typedef struct { float first; uint32_t child; } EmissionNode;
/* A direction of light that was found, (x, y) of the unit square. */
typedef struct { float at[2], cosine; uint32_t lamp; } EmissionSeen;

/* Plain values without pointers. All 0: nothing is known, and light leaves by the cosine law. */
typedef struct {
    uint64_t told, stride;         /* directions so far, of so many of which one is kept */
    Vec3 last;                     /* told */
    uint32_t lamps, kept, nodes;
    struct { uint32_t material, root /* 0: the cosine law */; } lamp[EMISSION_LAMPS];
    EmissionSeen seen[EMISSION_KEPT];
    EmissionNode node[EMISSION_NODES];
} Emission;

/* Light of a material (its number in the mesh) was found to leave in the unit direction w, at that cosine > 0 to the lamp's normal.
 * The same again at once counts as one: chains keep their first edge for long, but how long tells little. Materials beyond EMISSION_LAMPS are not told apart: they keep the cosine law. */
void emission_see(Emission *e, uint32_t material, Vec3 w, double cosine);

/* Makes the trees anew of all that was found so far. Where they would not bring much, the cosine law stays. */
void emission_learn(Emission *e);

/* Root of the material's tree, 0 if it has none. */
static inline uint32_t emission_root(const Emission *e, uint32_t material)
{
    for (uint32_t i = 0; i < e->lamps; i++)
        if (e->lamp[i].material == material) return e->lamp[i].root;
    return 0;
}

/* Whether any has. */
static inline bool emission_active(const Emission *e) { return e->nodes > 1; }

/* A unit direction from a surface of unit normal n, by the root of its material's tree. Where it is not above the surface, it is lost. */
Vec3 emission_sample(const Emission *e, uint32_t root, Vec3 n, Rng *rng);

/* Density per solid angle of emission_sample over that of the cosine law, at a unit direction w of that cosine > 0. */
double emission_ratio(const Emission *e, uint32_t root, Vec3 w, double cosine);
#endif
