/* Ways through specular vertices: from a vertex that is none, D, by the modes of a chain (or by narrow lobes, copied) to a point of a lamp. The direction that leads there is searched
 * for by Newton's method. [Jakob and Marschner 2012: manifold exploration; Hanika, Droske, Fascione 2015: manifold next event estimation]
 *
 * Vertices are numbered as in a path: v[d] is D, v[d-1] .. v[1] are specular, v[0] is the lamp's point. Knows no chain and no image. */
#ifndef SPECULAR_H
#define SPECULAR_H
#include "path.h"

enum { MOST_SPECULAR = 8 };        /* vertices of a chain */

/* Of v[d] .. v[0], whose edges have been computed (path_edge). */
SpecularWay specular_way(const Scene *scene, const Vertex *v, int d);

static const double SPECULAR_EITHER = 0.25;

/* How likely a bent walk (bend.h) finds such a way, pdf_w being the density per solid angle with which a first guess takes its direction and modes. */
typedef struct {
    double searched;               /* a chance with which what was found by chance may be followed up, so that the work is bounded */
    double nominal;                /* an estimate of the chance that it is found, and followed up; what multiple importance sampling goes by */
} SpecularChance;
/* A guess (bend.h) takes a mode of glass that the surface has a chance q of rather more evenly. */
static inline double specular_guess_q(double q) { return q < 1 ? (1 - SPECULAR_EITHER) * q + SPECULAR_EITHER / 2 : 1; }
static inline SpecularChance specular_chance(const SpecularWay *way, double pdf_w)
{
    static const double OFTEN = 4;
    double found = smaller(pdf_w * way->basin, 1), searched = way->through ? 1 : smaller(OFTEN * found, 1);
    return (SpecularChance){ searched, found * searched + (way->through ? 1 : 0) };
}

/* Whether ways of d edges to a lamp are looked for at all. Not to a mirror that emits: guesses go on from there. */
static inline bool specular_sought(const Point *lamp, int d) { return d - 1 <= MOST_SPECULAR && !material_is_specular(lamp->surface.material); }

/* Of the same the spread alone, by passage[d-1] .. passage[1], which may be narrow lobes. */
double specular_spread(const Scene *scene, const Passage passage[], const Vertex *v, int d);

/* Sets v[d-1] .. v[0] to the way from v[d] to the target by those passages that is found from a first guess w, if it is found, and nothing is in between. */
bool specular_search(const Scene *scene, const Passage passage[], Vertex *v, int d, Vec3 w, const Point *target);

/* Whether specular vertices of two ways of one length are nearer to each other than so much. */
bool specular_near(const Vertex *a, const Vertex *b, int d, double distance);
/* Two ways that were both found are the same if they are as near as that (scene unit). */
static const double SPECULAR_SAME = 1e-7;
#endif
