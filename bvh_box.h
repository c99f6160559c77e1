/* Boxes as the builder of the tree needs them (bvh_build.c; nobody else includes this): to be joined, met and measured by few instructions.
 * With AVX, with SSE2 (any x86-64), or left to the compiler. */
#ifndef BVH_BOX_H
#define BVH_BOX_H
#include "bvh_tree.h"
#include <string.h>
#ifdef __SSE2__
#include <immintrin.h>
#endif

/* Four floats, of which the box arithmetic uses three. */
#ifdef __SSE2__
typedef __m128 Quad;
static inline Quad q_load(const float *p) { return _mm_loadu_ps(p); }
static inline void q_store(float *p, Quad a) { _mm_storeu_ps(p, a); }
static inline Quad q_set(float f) { return _mm_set1_ps(f); }
static inline Quad q_point(const float p[3]) { return _mm_setr_ps(p[0], p[1], p[2], 0); }
static inline Quad q_min(Quad a, Quad b) { return _mm_min_ps(a, b); }
static inline Quad q_max(Quad a, Quad b) { return _mm_max_ps(a, b); }
static inline Quad q_add(Quad a, Quad b) { return _mm_add_ps(a, b); }
static inline Quad q_sub(Quad a, Quad b) { return _mm_sub_ps(a, b); }
static inline Quad q_mul(Quad a, Quad b) { return _mm_mul_ps(a, b); }
static inline void q_truncate(int bin[4], Quad a) { _mm_storeu_si128((__m128i *)(void *)bin, _mm_cvttps_epi32(a)); }
#else
typedef struct { float f[4]; } Quad;
static inline Quad q_load(const float *p) { Quad r; memcpy(r.f, p, sizeof r.f); return r; }
static inline void q_store(float *p, Quad a) { memcpy(p, a.f, sizeof a.f); }
static inline Quad q_set(float f) { return (Quad){ { f, f, f, f } }; }
static inline Quad q_point(const float p[3]) { return (Quad){ { p[0], p[1], p[2], 0 } }; }
static inline Quad q_min(Quad a, Quad b) { for (int i = 0; i < 4; i++) a.f[i] = least(a.f[i], b.f[i]); return a; }
static inline Quad q_max(Quad a, Quad b) { for (int i = 0; i < 4; i++) a.f[i] = greatest(a.f[i], b.f[i]); return a; }
static inline Quad q_add(Quad a, Quad b) { for (int i = 0; i < 4; i++) a.f[i] += b.f[i]; return a; }
static inline Quad q_sub(Quad a, Quad b) { for (int i = 0; i < 4; i++) a.f[i] -= b.f[i]; return a; }
static inline Quad q_mul(Quad a, Quad b) { for (int i = 0; i < 4; i++) a.f[i] *= b.f[i]; return a; }
static inline void q_truncate(int bin[4], Quad a) { for (int i = 0; i < 4; i++) bin[i] = (int)a.f[i]; }
#endif
static inline Quad q_minus(Quad a) { return q_sub(q_set(0), a); }

/* A box: its low sides, a float to spare, its high sides with the sign turned, a float to spare. Boxes join by a minimum of all eight. */
#ifdef __AVX__
typedef __m256 Box;
static inline Box box_load(const float *p) { return _mm256_loadu_ps(p); }
static inline void box_store(float *p, Box a) { _mm256_storeu_ps(p, a); }
static inline Box box_of(Quad low, Quad minus_high) { return _mm256_set_m128(minus_high, low); }
static inline Quad box_low(Box a) { return _mm256_castps256_ps128(a); }
static inline Quad box_minus_high(Box a) { return _mm256_extractf128_ps(a, 1); }
static inline Box box_join(Box a, Box b) { return _mm256_min_ps(a, b); }
static inline Box box_meet(Box a, Box b) { return _mm256_max_ps(a, b); }
#else
typedef struct { Quad low, minus_high; } Box;
static inline Box box_load(const float *p) { return (Box){ q_load(p), q_load(p + 4) }; }
static inline void box_store(float *p, Box a) { q_store(p, a.low); q_store(p + 4, a.minus_high); }
static inline Box box_of(Quad low, Quad minus_high) { return (Box){ low, minus_high }; }
static inline Quad box_low(Box a) { return a.low; }
static inline Quad box_minus_high(Box a) { return a.minus_high; }
static inline Box box_join(Box a, Box b) { return (Box){ q_min(a.low, b.low), q_min(a.minus_high, b.minus_high) }; }
static inline Box box_meet(Box a, Box b) { return (Box){ q_max(a.low, b.low), q_max(a.minus_high, b.minus_high) }; }
#endif
static inline Box box_empty(void) { return box_of(q_set(INFINITY), q_set(INFINITY)); }
static inline Box box_point(Quad p) { return box_of(p, q_minus(p)); }
static inline void box_sides(float d[4], Box b) { q_store(d, q_minus(q_add(box_low(b), box_minus_high(b)))); }

/* Half the surface area; only of boxes that are not empty. */
static inline float box_area(Box b)
{
    float d[4];
    box_sides(d, b);
    return d[0] * d[1] + d[1] * d[2] + d[2] * d[0];
}

/* Whether it is not empty. */
static inline bool box_valid(Box b)
{
    float d[4];
    box_sides(d, b);
    return d[0] >= 0 && d[1] >= 0 && d[2] >= 0;
}

/* The axis of its longest side. */
static inline int box_widest(Box b)
{
    float d[4];
    box_sides(d, b);
    return d[0] > d[1] ? (d[0] > d[2] ? 0 : 2) : (d[1] > d[2] ? 1 : 2);
}

/* Half the surface area of what two boxes share. */
static inline float box_overlap(Box a, Box b)
{
    Box both = box_meet(a, b);
    return box_valid(both) ? box_area(both) : 0;
}
#endif
