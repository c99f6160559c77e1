/* Ray queries against a triangle mesh: closest hit, and any hit along a segment.
 *
 * Knows triangles only: no materials, no paths. The tree is read-only once built and keeps its own copy of what it needs, laid out for the traversal.
 * Positions are in the scene's unit (scene.h): the mesh lies within a cube of half side 1 about the origin. */
#ifndef BVH_H
#define BVH_H
#include "vec.h"
#include <stddef.h>
#include <stdint.h>

static const uint32_t BVH_NONE = UINT32_MAX;   /* 'no triangle' for Ray.skip */

/* Points origin + t direction, 0 < t < t_max; the direction need not have length 1. The triangles skip[0] and skip[1] are never hit:
 * the ones that the ray starts on and, for a segment, ends on. The caller has already moved the ends off their surfaces (scene_offset). */
typedef struct {
    Vec3 origin, direction;
    double t_max;
    uint32_t skip[2];
} Ray;

/* The point (1-u-v) a + u b + v c of triangle (a,b,c). */
typedef struct {
    double t, u, v;
    uint32_t triangle;
} Hit;

typedef struct Bvh Bvh;

typedef enum { BVH_FAST, BVH_BEST } BvhEffort;

/* Builds a tree over n triangles (indices into position). Any finite input is legal: degenerate, duplicate, coplanar, n = 0.
 * Returns NULL only when memory runs out. The arrays are not kept. Free with bvh_free. */
Bvh *bvh_new(const float (*position)[3], const uint32_t (*triangle)[3], uint32_t n, BvhEffort effort);
void bvh_free(Bvh *bvh);
size_t bvh_bytes(const Bvh *bvh);

/* The nearest hit, or false. Watertight: no ray slips between two triangles that share an edge by vertex index or by equal coordinates. */
bool bvh_closest(const Bvh *bvh, const Ray *ray, Hit *hit);

/* Whether anything is hit: equal to bvh_closest's answer. */
bool bvh_any(const Bvh *bvh, const Ray *ray);
#endif
