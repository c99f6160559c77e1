/* The tree as it lies in memory: written by bvh_build.c, read by bvh.c; nobody else includes this.
 *
 * Nodes of eight children and groups of four triangles, side by side by component, so that one vector instruction serves all of them. They
 * stand in one array in units of 32 bytes: a node's groups right behind it, then the nodes below. */
#ifndef BVH_TREE_H
#define BVH_TREE_H
#include "bvh.h"

enum { WIDTH = 8, GROUP = 4, UNIT = 32, MAX_DEPTH = 64 };

/* A child is the place of a Node or a Group in units, times two, plus one if it is a Group. */
typedef uint32_t Child;

/* bound[2*axis] are the low sides, bound[2*axis+1] the high ones; an unused slot has low = +inf, high = -inf.
 * Children stand in the order of how likely they are to block a ray, the likeliest last. */
typedef struct { float bound[6][WIDTH]; Child child[WIDTH]; } Node;

/* Four triangles: vertex[corner][axis][lane]. An unused lane is a single point, which is never hit. */
typedef struct { float vertex[3][3][GROUP]; uint32_t id[GROUP]; } Group;

struct Bvh {
    unsigned char *tree;               /* nodes and groups, aligned to UNIT */
    void *allocation;
    size_t bytes;
    Child root;
    double reach;                      /* largest absolute coordinate */
    double low[3], high[3];
};

static inline float least(float a, float b) { return a < b ? a : b; }
static inline float greatest(float a, float b) { return a > b ? a : b; }
#endif
