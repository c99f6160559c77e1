/* Walks from the lens that are bent to meet a lamp through specular vertices: what light sampling is where nothing is between, for all that is lit through
 * glass or water or by mirrors, L S+ D. And walks from a lamp that are bent to meet the lens, for what is seen so and can be joined nowhere, L S+ D S+ E. [Hanika, Droske, Fascione 2015: manifold next event estimation; Zeltner, Georgiev, Jakob 2020: specular manifold sampling]
 *
 * To a point of a lamp, or of the lens, there may be several ways. One is searched for from the straight line to it (if that passes through refracting surfaces alone),
 * another from where the surface happens to scatter. How often the latter leads to the way that was found, p, has no formula; but if guesses are drawn
 * until one leads there again, their number is 1/p on average, and that is all that is needed. Where p is so small that the way is met by chance as easily,
 * they are not drawn for ever: after N of them the way counts as if found by the N-th, by (1-(1-p)^N)/p on average. What is missing is (1-p)^N, and a walk
 * that meets the lamp by chance brings it: in N guesses of its own it fails to find the way so often. Knows no pixels. */
#ifndef BEND_H
#define BEND_H
#include "specular.h"

/* A way from v[d] that was found, v[0] being the lamp's point. */
typedef struct {
    int d;
    Rgb rgb;                       /* f of all that lies between v[d] and the lamp, both included, over the lamp's area */
    double chance_pdf_a, pdf_a;    /* densities over that area: of a walk from v[d] that goes on by chance (0: none does); of bending it, nominally */
    double times;                  /* f over the sum of these and all other techniques' densities counts so many times: what was found in spite of a small
                                      nominal chance counts little, what was found by a guess the more often, the rarer guesses lead there */
} Bent;

/* 'at' is a vertex that is not specular, met by a walk from the direction 'known'; vertices towards the light are at[-1] .. at[-most], the most edges that
 * there may be. 'light' is uniform in [0,1)^3. 'found' is called for each way, v[d] being 'at'. */
void bend_walk(const Scene *scene, Vertex *at, int most, Vec3 known, const double light[3], Rng *rng, void (*found)(void *context, const Bent *bent), void *context);

/* What is left to a walk of so many edges that has met the lamp at v[0] by chance, v[1] being specular, if it could have been bent instead: by the balance
 * heuristic a share; and that counts so many times: once if enough guesses lead there, else 1/share on average, for then bent walks leave it all to chance. */
typedef struct { double share, times; } BendLeft;
BendLeft bend_left(const Scene *scene, Vertex *v, int edges, Rng *rng);

/* A walk from a lamp; wherever it meets what is not specular it is bent to a point of the lens, so long as none of its edges could be joined. Each path that it
 * makes is left in 'x', evaluated; f over its density (bend_density) counts so many times. */
void bend_from_light(const Space *space, Path *x, Rng *rng, void (*found)(void *context, double times), void *context);

/* Density over f of making such a path, nominally, which has been evaluated and is REACH_UNJOINED; 0 where none would. */
double bend_density(const Space *space, const Path *x);
#endif
