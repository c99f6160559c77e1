/* Random numbers: xoshiro256++ (Blackman and Vigna), seeded by splitmix64 from a seed and a stream number, one generator per chain.
 * The state is four words: it is saved with a run. */
#ifndef RNG_H
#define RNG_H
#include <math.h>
#include <stdint.h>

typedef struct { uint64_t s[4]; } Rng;

static inline uint64_t rng_mix(uint64_t *z)
{
    uint64_t r = (*z += 0x9e3779b97f4a7c15u);
    r = (r ^ (r >> 30)) * 0xbf58476d1ce4e5b9u;
    r = (r ^ (r >> 27)) * 0x94d049bb133111ebu;
    return r ^ (r >> 31);
}

/* Generators of different (seed, stream) are independent for every practical purpose. */
static inline Rng rng_new(uint64_t seed, uint64_t stream)
{
    uint64_t z = stream;
    z = seed ^ rng_mix(&z);
    Rng r;
    for (int i = 0; i < 4; i++) r.s[i] = rng_mix(&z);
    return r;
}

static inline uint64_t rng_bits(Rng *r)
{
    uint64_t *s = r->s, sum = s[0] + s[3], out = ((sum << 23) | (sum >> 41)) + s[0], t = s[1] << 17;
    s[2] ^= s[0]; s[3] ^= s[1]; s[1] ^= s[2]; s[0] ^= s[3]; s[2] ^= t; s[3] = (s[3] << 45) | (s[3] >> 19);
    return out;
}

/* Uniform on [0,1): a multiple of 2^-53, never 1. */
static inline double rng_double(Rng *r) { return (double)(rng_bits(r) >> 11) * 0x1p-53; }

/* Uniform in the unit disk, by rejection: no root, no sine. */
static inline void rng_disk(Rng *r, double *x, double *y)
{
    do {
        *x = 2 * rng_double(r) - 1;
        *y = 2 * rng_double(r) - 1;
    } while (*x * *x + *y * *y >= 1);
}

/* A point of the unit disk, never its middle, from one of the unit square: uniform if that is. */
static inline void disk_at(const double square[2], double disk[2])
{
    double r = sqrt(1 - square[0]), phi = 6.283185307179586 * square[1];
    disk[0] = r * cos(phi);
    disk[1] = r * sin(phi);
}

/* Uniform on 0 .. n-1; the bias of the multiply-shift is below n 2^-32. */
static inline uint32_t rng_index(Rng *r, uint32_t n) { return (uint32_t)(((rng_bits(r) >> 32) * n) >> 32); }
#endif
