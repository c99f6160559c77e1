/* Ray queries: a stack of nodes of eight children, each tested at once, and triangles in groups of four.
 *
 * Sources: Wald, Benthin, Boulos, Getting rid of packets (wide nodes for single rays); Woop, Benthin, Wald, Watertight ray/triangle
 * intersection.
 *
 * Why no ray slips through: each triangle is projected along the ray to a plane, where a vertex lands on the same point whichever triangle
 * it is reached by, and an edge's side is the sign of fl(fl(ab) - fl(cd)), which two triangles see exactly opposite or both as zero, and
 * zero counts as inside. Boxes are widened by more than the rounding errors of box and triangle test together (see begin).
 * That holds only while ab - cd is not contracted to a fused multiply-add: compile as -std=c11, not gnu11.
 *
 * Must not know: how the tree came about (bvh_build.c), materials, paths. */
#include "bvh_tree.h"
#include "cache.h"
#include <float.h>
#include <string.h>
#ifdef __SSE2__
#include <immintrin.h>
#endif

enum { STACK = (WIDTH - 1) * MAX_DEPTH + WIDTH };

/* What the traversal needs of a ray. Within it, t is measured along the largest component of the direction, called axis z of the shear. */
typedef struct {
    /* by the axes of the mesh; the fourth is not used */
    float inverse[4], near_offset[4], far_offset[4];
    uint32_t near_side[4];             /* row of Node.bound that is met first */
    /* in the order x, y, z */
    float origin[4];
    float rest[4];                     /* what rounding the origin to float left out, sheared */
    float shear[4];                    /* the third is the sign of the direction */
    unsigned x, y, z;                  /* axes of the mesh that play x, y, z */
    float t_max;
    uint32_t skip[2];
    double t_shift, t_scale;           /* the ray's own t = (t + t_shift) * t_scale */
} Walk;

/* A component of (almost) zero becomes this: over the mesh's size the ray moves by much less than boxes are widened. */
static const float TINY = 1e-12f;

typedef struct { float t[GROUP], u[GROUP], v[GROUP]; } Lanes;

/* ---- vectors: with AVX2 and FMA, with SSE2 (any x86-64), or left to the compiler ---- */

#ifdef __SSE2__
/* c + ab and c - ab, where one rounding or two make no difference to the argument above. */
#ifdef __FMA__
static inline __m128 plus_product(__m128 a, __m128 b, __m128 c) { return _mm_fmadd_ps(a, b, c); }
static inline __m128 minus_product(__m128 a, __m128 b, __m128 c) { return _mm_fnmadd_ps(a, b, c); }
#else
static inline __m128 plus_product(__m128 a, __m128 b, __m128 c) { return _mm_add_ps(c, _mm_mul_ps(a, b)); }
static inline __m128 minus_product(__m128 a, __m128 b, __m128 c) { return _mm_sub_ps(c, _mm_mul_ps(a, b)); }
#endif

/* Which children the ray meets before t_max, and from what t on. */
#if defined __AVX2__ && defined __FMA__
static inline unsigned meet_children(const Node *node, const Walk *w, float t_max, float near[WIDTH])
{
    __m256 t0 = _mm256_setzero_ps(), t1 = _mm256_set1_ps(t_max);
    for (unsigned a = 0; a < 3; a++) {
        __m256 inverse = _mm256_set1_ps(w->inverse[a]);
        t0 = _mm256_max_ps(_mm256_fmadd_ps(_mm256_loadu_ps(node->bound[w->near_side[a]]), inverse, _mm256_set1_ps(w->near_offset[a])), t0);
        t1 = _mm256_min_ps(_mm256_fmadd_ps(_mm256_loadu_ps(node->bound[w->near_side[a] ^ 1]), inverse, _mm256_set1_ps(w->far_offset[a])), t1);
    }
    _mm256_storeu_ps(near, t0);
    return (unsigned)_mm256_movemask_ps(_mm256_cmp_ps(t0, t1, _CMP_LE_OQ));
}
#else
static inline unsigned meet_children(const Node *node, const Walk *w, float t_max, float near[WIDTH])
{
    unsigned mask = 0;
    for (int half = 0; half < WIDTH; half += 4) {
        __m128 t0 = _mm_setzero_ps(), t1 = _mm_set1_ps(t_max);
        for (unsigned a = 0; a < 3; a++) {
            __m128 inverse = _mm_set1_ps(w->inverse[a]);
            const float *first = node->bound[w->near_side[a]] + half, *second = node->bound[w->near_side[a] ^ 1] + half;
            t0 = _mm_max_ps(plus_product(_mm_loadu_ps(first), inverse, _mm_set1_ps(w->near_offset[a])), t0);
            t1 = _mm_min_ps(plus_product(_mm_loadu_ps(second), inverse, _mm_set1_ps(w->far_offset[a])), t1);
        }
        _mm_storeu_ps(near + half, t0);
        mask |= (unsigned)_mm_movemask_ps(_mm_cmple_ps(t0, t1)) << half;
    }
    return mask;
}
#endif

/* Which triangles the ray meets before t_max; where, is written only if there is one. */
static inline unsigned meet_triangles(const Group *group, const Walk *w, float t_max, Lanes *at)
{
    __m128 ox = _mm_set1_ps(w->origin[0]), oy = _mm_set1_ps(w->origin[1]), oz = _mm_set1_ps(w->origin[2]);
    __m128 sx = _mm_set1_ps(w->shear[0]), sy = _mm_set1_ps(w->shear[1]), rx = _mm_set1_ps(w->rest[0]), ry = _mm_set1_ps(w->rest[1]);
    __m128 x[3], y[3], z[3];
    for (int i = 0; i < 3; i++) {
        z[i] = _mm_sub_ps(_mm_loadu_ps(group->vertex[i][w->z]), oz);
        x[i] = minus_product(sx, z[i], _mm_sub_ps(_mm_sub_ps(_mm_loadu_ps(group->vertex[i][w->x]), ox), rx));
        y[i] = minus_product(sy, z[i], _mm_sub_ps(_mm_sub_ps(_mm_loadu_ps(group->vertex[i][w->y]), oy), ry));
    }
    __m128 a = _mm_sub_ps(_mm_mul_ps(x[2], y[1]), _mm_mul_ps(y[2], x[1]));
    __m128 b = _mm_sub_ps(_mm_mul_ps(x[0], y[2]), _mm_mul_ps(y[0], x[2]));
    __m128 c = _mm_sub_ps(_mm_mul_ps(x[1], y[0]), _mm_mul_ps(y[1], x[0]));
    __m128 sum = _mm_add_ps(a, _mm_add_ps(b, c)), flip = _mm_and_ps(sum, _mm_set1_ps(-0.0f));
    a = _mm_xor_ps(a, flip); b = _mm_xor_ps(b, flip); c = _mm_xor_ps(c, flip); sum = _mm_xor_ps(sum, flip);
    __m128 t = _mm_mul_ps(plus_product(a, z[0], plus_product(b, z[1], _mm_mul_ps(c, z[2]))), _mm_set1_ps(w->shear[2]));
    __m128 inside = _mm_cmpge_ps(_mm_min_ps(a, _mm_min_ps(b, c)), _mm_setzero_ps());
    __m128 between = _mm_and_ps(_mm_cmpgt_ps(t, _mm_setzero_ps()), _mm_cmplt_ps(t, _mm_mul_ps(_mm_set1_ps(t_max), sum)));
    __m128 meets = _mm_and_ps(inside, between);
    unsigned mask = (unsigned)_mm_movemask_ps(meets);
    if (!mask) return 0;
    __m128i id = _mm_loadu_si128((const __m128i *)(const void *)group->id);
    __m128i skip = _mm_or_si128(_mm_cmpeq_epi32(id, _mm_set1_epi32((int)w->skip[0])), _mm_cmpeq_epi32(id, _mm_set1_epi32((int)w->skip[1])));
    _mm_storeu_ps(at->t, _mm_div_ps(t, sum));
    _mm_storeu_ps(at->u, _mm_div_ps(b, sum));
    _mm_storeu_ps(at->v, _mm_div_ps(c, sum));
    return mask & ~(unsigned)_mm_movemask_ps(_mm_castsi128_ps(skip));
}

/* Keeps gcc from loading several members of a ray at once: right after they were written one by one, that load waits for all of the writes. */
static inline double scalar(double a) { __asm__("" : "+x"(a)); return a; }
#else
static inline unsigned meet_children(const Node *node, const Walk *w, float t_max, float near[WIDTH])
{
    float far[WIDTH];
    for (int i = 0; i < WIDTH; i++) { near[i] = 0; far[i] = t_max; }
    for (unsigned a = 0; a < 3; a++) {
        const float *first = node->bound[w->near_side[a]], *second = node->bound[w->near_side[a] ^ 1];
        float inverse = w->inverse[a], n = w->near_offset[a], f = w->far_offset[a];
        for (int i = 0; i < WIDTH; i++) {
            near[i] = greatest(first[i] * inverse + n, near[i]);
            far[i] = least(second[i] * inverse + f, far[i]);
        }
    }
    unsigned mask = 0;
    for (int i = 0; i < WIDTH; i++) mask |= near[i] <= far[i] ? 1u << i : 0;
    return mask;
}

static inline unsigned meet_triangles(const Group *group, const Walk *w, float t_max, Lanes *at)
{
    float x[3][GROUP], y[3][GROUP], z[3][GROUP], a[GROUP], b[GROUP], c[GROUP], sum[GROUP], t[GROUP];
    for (int k = 0; k < 3; k++)
        for (int i = 0; i < GROUP; i++) {
            z[k][i] = group->vertex[k][w->z][i] - w->origin[2];
            x[k][i] = group->vertex[k][w->x][i] - w->origin[0] - w->rest[0] - w->shear[0] * z[k][i];
            y[k][i] = group->vertex[k][w->y][i] - w->origin[1] - w->rest[1] - w->shear[1] * z[k][i];
        }
    int meets[GROUP], any = 0;
    for (int i = 0; i < GROUP; i++) {
        /* one product a statement: a compiler may not fuse across them */
        float a0 = x[2][i] * y[1][i], a1 = y[2][i] * x[1][i];
        float b0 = x[0][i] * y[2][i], b1 = y[0][i] * x[2][i];
        float c0 = x[1][i] * y[0][i], c1 = y[1][i] * x[0][i];
        float d = (a0 - a1) + ((b0 - b1) + (c0 - c1)), flip = d < 0 ? -1.0f : 1.0f;
        a[i] = (a0 - a1) * flip; b[i] = (b0 - b1) * flip; c[i] = (c0 - c1) * flip; sum[i] = d * flip;
        t[i] = (a[i] * z[0][i] + b[i] * z[1][i] + c[i] * z[2][i]) * w->shear[2];
        meets[i] = (least(a[i], least(b[i], c[i])) >= 0) & (t[i] > 0) & (t[i] < t_max * sum[i]);
        any |= meets[i];
    }
    if (!any) return 0;
    unsigned mask = 0;
    for (int i = 0; i < GROUP; i++) {
        at->t[i] = t[i] / sum[i]; at->u[i] = b[i] / sum[i]; at->v[i] = c[i] / sum[i];
        mask |= (unsigned)(meets[i] & (group->id[i] != w->skip[0]) & (group->id[i] != w->skip[1])) << i;
    }
    return mask;
}

static inline double scalar(double a) { return a; }
#endif

/* The parts of a walk that are vectors; d is scaled so that, rounded to float, d[z] is 1 or -1. */
#if defined __AVX2__ && defined __FMA__
static inline void aim(Walk *w, const double o[3], const double d[3], double widen)
{
    static const uint32_t order[3][4] = { { 1, 2, 0, 3 }, { 2, 0, 1, 3 }, { 0, 1, 2, 3 } };
    __m256d o4 = _mm256_set_pd(0, o[2], o[1], o[0]);
    __m128 minus = _mm_set1_ps(-0.0f), direction = _mm256_cvtpd_ps(_mm256_set_pd(1, d[2], d[1], d[0]));
    __m128 origin = _mm256_cvtpd_ps(o4), rest = _mm256_cvtpd_ps(_mm256_sub_pd(o4, _mm256_cvtps_pd(origin)));
    __m128 safe = _mm_or_ps(_mm_and_ps(minus, direction), _mm_max_ps(_mm_andnot_ps(minus, direction), _mm_set1_ps(TINY)));
    __m128 inverse = _mm_div_ps(_mm_set1_ps(1), safe), wide = _mm_mul_ps(_mm_set1_ps((float)widen), _mm_andnot_ps(minus, inverse));
    __m128i side = _mm_add_epi32(_mm_srli_epi32(_mm_castps_si128(inverse), 31), _mm_setr_epi32(0, 2, 4, 0));
    _mm_storeu_ps(w->inverse, inverse);
    _mm_storeu_ps(w->near_offset, _mm_fnmsub_ps(origin, inverse, wide));
    _mm_storeu_ps(w->far_offset, _mm_fnmadd_ps(origin, inverse, wide));
    _mm_storeu_si128((__m128i *)(void *)w->near_side, side);
    __m128i to_xyz = _mm_loadu_si128((const __m128i *)(const void *)order[w->z]);
    __m128 turned = _mm_permutevar_ps(direction, to_xyz), rest_xyz = _mm_permutevar_ps(rest, to_xyz);
    __m128 sign = _mm_permute_ps(turned, 0xaa), rest_z = _mm_permute_ps(rest_xyz, 0xaa);
    __m128 shear = _mm_mul_ps(turned, sign);
    _mm_storeu_ps(w->origin, _mm_permutevar_ps(origin, to_xyz));
    _mm_storeu_ps(w->rest, _mm_fnmadd_ps(shear, rest_z, rest_xyz));
    _mm_storeu_ps(w->shear, _mm_blend_ps(shear, turned, 4));
}
#else
static inline void aim(Walk *w, const double o[3], const double d[3], double widen)
{
    for (unsigned a = 0; a < 3; a++) {
        float origin = (float)o[a], direction = (float)d[a], wide = (float)widen;
        float inverse = 1 / (fabsf(direction) > TINY ? direction : copysignf(TINY, direction));
        w->inverse[a] = inverse;
        w->near_offset[a] = -origin * inverse - wide * fabsf(inverse);
        w->far_offset[a] = -origin * inverse + wide * fabsf(inverse);
        w->near_side[a] = 2 * a + (inverse < 0);
    }
    unsigned axis[3] = { w->x, w->y, w->z };
    float rest[3];
    for (int k = 0; k < 3; k++) {
        w->origin[k] = (float)o[axis[k]];
        w->shear[k] = (float)(d[axis[k]] * d[w->z]);
        rest[k] = (float)(o[axis[k]] - (double)w->origin[k]);
    }
    for (int k = 0; k < 2; k++) w->rest[k] = rest[k] - w->shear[k] * rest[2];
    w->shear[2] = (float)d[w->z];
}
#endif

/* Places of bits in a mask of children; any answer will do if there is none. */
#ifdef __GNUC__
static inline unsigned lowest(unsigned mask) { return (unsigned)__builtin_ctz(mask | 1u << WIDTH); }
static inline unsigned highest(unsigned mask) { return 31 - (unsigned)__builtin_clz(mask | 1); }
static inline unsigned count_bits(unsigned mask) { return (unsigned)__builtin_popcount(mask); }
#else
static inline unsigned lowest(unsigned mask)
{
    unsigned i = 0;
    while (i < WIDTH && !(mask >> i & 1)) i++;
    return i;
}

static inline unsigned highest(unsigned mask)
{
    unsigned i = WIDTH - 1;
    while (i > 0 && !(mask >> i & 1)) i--;
    return i;
}

static inline unsigned count_bits(unsigned mask)
{
    unsigned n = 0;
    for (; mask; mask &= mask - 1) n++;
    return n;
}
#endif

static inline const Node *node_at(const Bvh *bvh, Child c) { return (const Node *)(const void *)(bvh->tree + (size_t)(c >> 1) * UNIT); }
static inline const Group *group_at(const Bvh *bvh, Child c) { return (const Group *)(const void *)(bvh->tree + (size_t)(c >> 1) * UNIT); }

/* Four lines hold a node, three a group. Worth a quarter of the time of closest hits in large trees. */
static inline void prefetch(const Bvh *bvh, Child c)
{
    const unsigned char *p = bvh->tree + (size_t)(c >> 1) * UNIT;
    for (int line = 0; line < 4; line++) prefetch_line(p + 64 * line);
}

/* Moves an origin that is far off to near the mesh, in double, so that float suffices from there on. False if the ray misses the mesh.
 * d is scaled to a largest component of one; the parameters are along it. */
static bool approach(const Bvh *bvh, double o[3], const double d[3], double *t_shift)
{
    double enter = 0, leave = DBL_MAX, margin = bvh->reach * 1e-3;
    for (int a = 0; a < 3; a++) {
        double slack = margin + 1e-14 * fabs(o[a]), low = bvh->low[a] - slack - o[a], high = bvh->high[a] + slack - o[a];
        if (d[a] == 0) {
            if (low > 0 || high < 0) return false;
            continue;
        }
        double t0 = low / d[a], t1 = high / d[a];
        enter = fmax(enter, fmin(t0, t1));
        leave = fmin(leave, fmax(t0, t1));
    }
    if (!(enter <= leave)) return false;
    *t_shift = enter;
    for (int a = 0; a < 3; a++) o[a] += enter * d[a];
    return true;
}

/* Prepares a ray; false if it cannot hit anything. */
static inline bool begin(const Bvh *bvh, const Ray *ray, Walk *w)
{
    double o[3] = { scalar(ray->origin.x), scalar(ray->origin.y), scalar(ray->origin.z) };
    double d[3] = { scalar(ray->direction.x), scalar(ray->direction.y), scalar(ray->direction.z) };
    static const unsigned char next[3] = { 1, 2, 0 };
    double ax = fabs(d[0]), ay = fabs(d[1]), az = fabs(d[2]), most = larger(ax, ay);
    /* Selected without branches, which could not be predicted. */
    unsigned is_z = az > most, z = ((ay > ax) & !is_z) | is_z << 1;
    most = larger(most, az);
    unsigned x = next[z], y = next[x];
    w->t_scale = 1 / most;
    for (int a = 0; a < 3; a++) d[a] *= w->t_scale;
    w->t_shift = 0;
    double far = larger(fabs(o[0]), larger(fabs(o[1]), fabs(o[2])));
    if (far > 4 * bvh->reach) {
        if (!approach(bvh, o, d, &w->t_shift)) return false;
        far = larger(fabs(o[0]), larger(fabs(o[1]), fabs(o[2])));
    }
    double t_max = ray->t_max * most - w->t_shift;
    if (!(t_max > 0)) return false;
    w->t_max = t_max < (double)FLT_MAX ? (float)t_max : FLT_MAX;

    /* Rounding moves a plane's t by at most 6 e (|o| + |plane|) / |d|, where e = 2^-24 (once each for o, d, 1/d and the operations of
     * aim and meet_children), and the triangle test moves a hit by at most some 8 e (|o| + |vertex|); the boxes are widened by more than
     * the sum, for free: it hides in the offsets. */
    w->x = x; w->y = y; w->z = z;
    aim(w, o, d, 16 * 0x1p-24 * (far + bvh->reach));
    w->skip[0] = ray->skip[0]; w->skip[1] = ray->skip[1];
    return true;
}

/* Stack entries compare by their t, which is not negative, so that its bits are in its order. */
static inline uint64_t entry(float near, Child child)
{
    uint32_t bits;
    memcpy(&bits, &near, sizeof bits);
    return (uint64_t)bits << 32 | child;
}

static inline float entry_near(uint64_t e)
{
    uint32_t bits = (uint32_t)(e >> 32);
    float near;
    memcpy(&near, &bits, sizeof near);
    return near;
}

bool bvh_closest(const Bvh *bvh, const Ray *ray, Hit *hit)
{
    Walk w;
    if (!begin(bvh, ray, &w)) return false;
    uint64_t stack[STACK];
    size_t n = 0;
    float t_max = w.t_max, u = 0, v = 0;
    uint32_t triangle = BVH_NONE;
    Child at = bvh->root;
    for (;;) {
        if (!(at & 1)) {
            const Node *node = node_at(bvh, at);
            float near[WIDTH];
            unsigned mask = meet_children(node, &w, t_max, near);
            if (mask) {
                /* The nearest child is next, the others go onto the stack, farthest first. One or two are by far the most frequent. */
                unsigned i = lowest(mask), rest = mask & (mask - 1), j = lowest(rest);
                if (!rest) { at = node->child[i]; continue; }
                if (!(rest & (rest - 1))) {
                    uint64_t e = entry(near[i], node->child[i]), f = entry(near[j], node->child[j]);
                    prefetch(bvh, node->child[i]);
                    prefetch(bvh, node->child[j]);
                    stack[n++] = e < f ? f : e;
                    at = (Child)(e < f ? e : f);
                    continue;
                }
                for (size_t base = n; mask; mask &= mask - 1) {
                    i = lowest(mask);
                    uint64_t e = entry(near[i], node->child[i]);
                    prefetch(bvh, node->child[i]);
                    size_t k = n++;
                    for (; k > base && stack[k - 1] < e; k--) stack[k] = stack[k - 1];
                    stack[k] = e;
                }
                at = (Child)stack[--n];
                continue;
            }
        } else {
            const Group *group = group_at(bvh, at);
            Lanes lanes;
            for (unsigned mask = meet_triangles(group, &w, t_max, &lanes); mask; mask &= mask - 1) {
                unsigned i = lowest(mask);
                if (lanes.t[i] < t_max || triangle == BVH_NONE) {
                    t_max = lanes.t[i]; u = lanes.u[i]; v = lanes.v[i];
                    triangle = group->id[i];
                }
            }
        }
        do if (!n) goto done;
        while (entry_near(stack[--n]) > t_max);
        at = (Child)stack[n];
    }
done:
    if (triangle == BVH_NONE) return false;
    *hit = (Hit){ ((double)t_max + w.t_shift) * w.t_scale, (double)u, (double)v, triangle };
    return true;
}

bool bvh_any(const Bvh *bvh, const Ray *ray)
{
    Walk w;
    if (!begin(bvh, ray, &w)) return false;
    Child stack[STACK];
    size_t n = 0;
    stack[n++] = bvh->root;
    while (n) {
        Child at = stack[--n];
        if (at & 1) {
            Lanes lanes;
            if (meet_triangles(group_at(bvh, at), &w, w.t_max, &lanes)) return true;
        } else {
            const Node *node = node_at(bvh, at);
            float near[WIDTH];
            unsigned mask = meet_children(node, &w, w.t_max, near), met = count_bits(mask);
            if (!mask) continue;
            /* Children stand in the order of collapse: the last is the likeliest to block. */
            if (met <= 2) {
                /* No branch on how many there are, which could not be predicted: with fewer, a place above the stack is written in vain. */
                Child c = node->child[lowest(mask) % WIDTH], d = node->child[highest(mask) % WIDTH];
                prefetch(bvh, c);
                prefetch(bvh, d);
                stack[n] = c;
                stack[n + (met >> 1)] = d;
                n += met;
            } else
                for (; mask; mask &= mask - 1) {
                    Child c = node->child[lowest(mask)];
                    prefetch(bvh, c);
                    stack[n++] = c;
                }
        }
    }
    return false;
}
