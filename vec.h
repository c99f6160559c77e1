/* Three-vectors of doubles: points, directions and RGB colours. Plain values, nothing else.
 * Used everywhere; knows nothing of the renderer. */
#ifndef VEC_H
#define VEC_H
#include <math.h>
#include <stdbool.h>

typedef struct { double x, y, z; } Vec3;
typedef Vec3 Rgb;                      /* x, y, z = linear red, green, blue (Rec. 709 primaries) */

static const double PI = 3.14159265358979323846;

static inline Vec3 vec3(double x, double y, double z) { return (Vec3){ x, y, z }; }
static inline Vec3 add(Vec3 a, Vec3 b) { return vec3(a.x + b.x, a.y + b.y, a.z + b.z); }
static inline Vec3 sub(Vec3 a, Vec3 b) { return vec3(a.x - b.x, a.y - b.y, a.z - b.z); }
static inline Vec3 mul(Vec3 a, Vec3 b) { return vec3(a.x * b.x, a.y * b.y, a.z * b.z); }
static inline Vec3 scale(double s, Vec3 a) { return vec3(s * a.x, s * a.y, s * a.z); }
static inline Vec3 neg(Vec3 a) { return vec3(-a.x, -a.y, -a.z); }
/* a + s b */
static inline Vec3 along(Vec3 a, double s, Vec3 b) { return vec3(a.x + s * b.x, a.y + s * b.y, a.z + s * b.z); }
static inline double dot(Vec3 a, Vec3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
static inline Vec3 cross(Vec3 a, Vec3 b)
{
    return vec3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}
static inline double length(Vec3 a) { return sqrt(dot(a, a)); }
static inline Vec3 normalize(Vec3 a) { return scale(1 / length(a), a); }
static inline bool finite3(Vec3 a) { return isfinite(a.x) && isfinite(a.y) && isfinite(a.z); }
/* fmin and fmax without their care for NaN, which costs a call */
static inline double smaller(double a, double b) { return a < b ? a : b; }
static inline double larger(double a, double b) { return a > b ? a : b; }
static inline double max3(Vec3 a) { return larger(a.x, larger(a.y, a.z)); }
static inline Vec3 from_float(const float f[3]) { return vec3((double)f[0], (double)f[1], (double)f[2]); }

/* Rec. 709 luminance */
static inline double luminance(Rgb c) { return 0.2126 * c.x + 0.7152 * c.y + 0.0722 * c.z; }

/* Two unit vectors that make a right-handed frame (a, b, n) with the unit vector n; continuous but at n.z = -1..+1's sign change.
 * Source: Duff et al., Building an Orthonormal Basis, Revisited. */
static inline void frame(Vec3 n, Vec3 *a, Vec3 *b)
{
    double sign = copysign(1, n.z), p = -1 / (sign + n.z), q = n.x * n.y * p;
    *a = vec3(1 + sign * n.x * n.x * p, sign * q, -sign * n.x);
    *b = vec3(q, sign + n.y * n.y * p, -n.y);
}
#endif
