/* Random numbers: the stream is the published one, 1 never comes. Sums: how many splats a pixel can take. */
#include "../path.h"
#include "check.h"

static void test_stream(void)
{
    /* splitmix64 from 0 and xoshiro256++ from 1, 2, 3, 4: the values that the published code gives */
    static const uint64_t mixed[3] = { 0xe220a8397b1dcdaf, 0x6e789e6aa1b965f4, 0x06c45d188009454f };
    static const uint64_t drawn[6] = { 41943041, 58720359, 3588806011781223, 3591011842654386, 9228616714210784205u, 9973669472204895162u };
    uint64_t z = 0;
    for (int i = 0; i < 3; i++) CHECK(rng_mix(&z) == mixed[i]);
    Rng r = { { 1, 2, 3, 4 } };
    for (int i = 0; i < 6; i++) CHECK(rng_bits(&r) == drawn[i]);
    Rng a = rng_new(1, 2), b = rng_new(1, 2), c = rng_new(2, 2), d = rng_new(1, 3);
    uint64_t first = rng_bits(&a);
    CHECK(first == rng_bits(&b) && first != rng_bits(&c) && first != rng_bits(&d));
}

/* A state whose next output is 'bits'. */
static Rng about_to_give(uint64_t bits)
{
    Rng r = { { 0, 0, 0, bits >> 23 | bits << 41 } };      /* s[0] = 0: the output is s[3], turned left by 23 */
    return r;
}

static void test_range(void)
{
    Rng largest = about_to_give(UINT64_MAX), again = largest, index = largest, smallest = about_to_give(0);
    CHECK(rng_bits(&again) == UINT64_MAX);
    CHECK(rng_double(&largest) == 1 - 0x1p-53);
    CHECK(rng_double(&smallest) == 0);
    CHECK(rng_index(&index, UINT32_MAX) == UINT32_MAX - 1);
}

/* A chain's film sums in double. A splat of weight w rounds a sum S by at most 2^-53 S: after 1e10 splats of about 1 that is 1e-6 of a splat, always
 * to one side where all are equal, to either where they differ. So the sum is good to 1e-6 in the worst case and to some 1e-11 in practice;
 * rounds, which have films of their own, only make it better. Here the last of the 1e10 splats, on a pixel that holds all the others. */
static void test_sums(void)
{
    enum { SPLATS = 1000000 };
    const double before = 1e10;
    Pixel pixel = { .sum = { 1e10, 1e10 } };
    double exact = 0;
    for (int i = 0; i < SPLATS; i++) pixel.sum[0] += 1.0 / 3;
    double equal = pixel.sum[0];
    CHECK_NEAR((equal - before) / (SPLATS / 3.0), 1, 3e-6);           /* a third of the 1e-6 above would be a splat of 1 */
    CHECK_NEAR(equal / (before + SPLATS / 3.0), 1, 1e-9);
    Rng rng = rng_new(1, 1);
    for (int i = 0; i < SPLATS; i++) {
        double splat = 2 * rng_double(&rng);
        pixel.sum[1] += splat;
        exact += splat;
    }
    double varied = pixel.sum[1];
    CHECK_NEAR((varied - before) / exact, 1, 1e-8);
    CHECK_NEAR(varied / (before + exact), 1, 1e-11);
    float single = (float)before;                                      /* which a film of floats would not pass */
    for (int i = 0; i < SPLATS; i++) single += 1.0f / 3;
    CHECK((double)single == before);
}

int main(void)
{
    test_stream();
    test_range();
    test_sums();
    return check_report();
}
