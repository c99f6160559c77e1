/* Materials against their formulas: densities by quadrature and chi-square, F, S> and S< recomputed, reciprocity, Fresnel, Snell, energy.
 *
 * Reference: reference.h, written from the formulas; here also what it takes on trust from the renderer, the density of the diffuse lobes, and
 * the Jacobian of the specular ones. Each statistical test is shown a fault that it must see. Fixed seeds, nothing is tried twice. */
#include "check.h"
#include "reference.h"
#include "statistics.h"
#include <stdlib.h>

/* |deviate| of a single comparison: two-sided 2e-9; with some 400 comparisons a false alarm has a chance below 1e-6. */
static const double DEVIATE = 6;

static Vec3 polar(double theta, double phi) { return vec3(sin(theta) * cos(phi), sin(theta) * sin(phi), cos(theta)); }

/* uniform on the sphere */
static Vec3 anywhere(Rng *rng)
{
    double z = 2 * rng_double(rng) - 1, phi = 2 * PI * rng_double(rng), r = sqrt(1 - z * z);
    return vec3(r * cos(phi), r * sin(phi), z);
}

static Surface surface_of(const Material *m, double tilt)
{
    Surface s = { m, m->kd, { 0.36, 0.48, 0.8 }, { 0, 0, 1 } };    /* ng: a unit vector off the axes */
    s.ng = normalize(s.ng);
    Vec3 a, b;
    frame(s.ng, &a, &b);
    s.ns = normalize(add(scale(cos(tilt), s.ng), scale(sin(tilt), add(scale(0.6, a), scale(0.8, b)))));
    return s;
}

/* ---- densities and samples of diffuse materials ---- */

/* The sampler and the density that a test is about; faulty ones are passed too. */
typedef bool Sample(const Surface *s, Vec3 known, Rng *rng, Vec3 *w, Mode *mode);
typedef double Density(const Surface *s, Vec3 known, Vec3 w);     /* per projected solid angle */

static double density_off(const Surface *s, Vec3 known, Vec3 w) { return 1.02 * bsdf_pdf_pw(s, known, w); }
static double density_without_cosine(const Surface *s, Vec3 known, Vec3 w)
{
    double c = fabs(dot(w, s->ng));
    return c > 0 ? bsdf_pdf_pw(s, known, w) / c : 0;               /* the cosine divided out twice */
}
static double density_geometric(const Surface *s, Vec3 known, Vec3 w)   /* as if n_s were n_g */
{
    Surface flat = *s;
    flat.ns = s->ng;
    return bsdf_pdf_pw(&flat, known, w);
}
static bool sample_again(const Surface *s, Vec3 known, Rng *rng, Vec3 *w, Mode *mode)   /* redraws what is lost */
{
    for (int i = 0; i < 1000; i++)
        if (bsdf_sample(s, known, rng, w, mode)) return true;
    return false;
}

/* Visits directions spread over the sphere as far as w may scatter, each with its measure of solid angle: by a cosine law about n_s and, for the
 * sharp lobe, by cos^n about the mirror direction, each weighed by its share of both densities, so that integrands stay smooth whatever the
 * exponent. Points of a Fibonacci lattice: no rows that an edge could lie along. */
static void quadrature(const Surface *s, Vec3 known, void (*visit)(void *context, Vec3 w, double measure), void *context)
{
    enum { POINTS = 46368, TURN = 28657 };         /* neighbours in Fibonacci's sequence */
    double sign = dot(known, s->ns) < 0 ? -1 : 1, e = s->material->ns;
    Vec3 pole = scale(sign, s->ns), mirror = normalize(sub(scale(2 * dot(known, s->ns), s->ns), known)), a, b, c, d;
    frame(pole, &a, &b);
    frame(mirror, &c, &d);
    bool lobe = max3(s->material->ks) > 0;
    for (int part = 0; part < (lobe ? 2 : 1); part++)
        for (uint64_t i = 0; i < POINTS; i++) {
            double u = ((double)i + 0.5) / POINTS, phi = 2 * PI * (double)(i * TURN % POINTS) / POINTS;
            double z = part ? pow(u, 1 / (e + 1)) : sqrt(u), r = part ? sqrt(-expm1(2 * log(u) / (e + 1))) : sqrt(1 - u);
            Vec3 w = part ? add(scale(z, mirror), add(scale(r * cos(phi), c), scale(r * sin(phi), d)))
                          : add(scale(z, pole), add(scale(r * cos(phi), a), scale(r * sin(phi), b)));
            double p_cosine = fmax(0, dot(w, pole)) / PI, cosine = part ? z : dot(w, mirror);
            double p_lobe = lobe && cosine > 0 ? (e + 1) / (2 * PI) * pow(fmin(cosine, 1), e) : 0;
            visit(context, w, 1 / (p_cosine + p_lobe) / POINTS);
        }
}

/* Bins: where about n_g (8 x 8 over the sphere), or, for a sharp lobe, where about the mirror direction (8 scales x 8). */
enum { BINS = 129, LOST = 128 };
typedef struct {
    const Surface *s;
    Vec3 known, a, b, c, d, mirror;
    Density *density;
    bool sharp;
    double expected[BINS], total;
} Bins;

static Bins bins_of(const Surface *s, Vec3 known, Density *density)
{
    Bins bins = { .s = s, .known = known, .density = density, .sharp = max3(s->material->ks) > 0 && s->material->ns > 20 };
    frame(s->ng, &bins.a, &bins.b);
    bins.mirror = normalize(sub(scale(2 * dot(known, s->ns), s->ns), known));
    frame(bins.mirror, &bins.c, &bins.d);
    return bins;
}

static int bin(const Bins *bins, Vec3 w)
{
    double z = dot(w, bins->s->ng), phi = atan2(dot(w, bins->b), dot(w, bins->a)) / (2 * PI) + 0.5;
    Vec3 off = sub(w, bins->mirror);
    double sin2_half = dot(off, off) / 4, cosine = 1 - 2 * sin2_half;
    if (bins->sharp && cosine > 0) {
        double u = exp((bins->s->material->ns + 1) * log1p(-2 * sin2_half)), psi = atan2(dot(w, bins->d), dot(w, bins->c)) / (2 * PI) + 0.5;
        if (u > 0.01) return 64 + (int)fmin(u * 8, 7) * 8 + (int)fmin(psi * 8, 7);
    }
    return (int)fmin((z + 1) * 4, 7) * 8 + (int)fmin(phi * 8, 7);
}

static void add_expected(void *context, Vec3 w, double measure)
{
    Bins *bins = context;
    double p = bins->density(bins->s, bins->known, w) * fabs(dot(w, bins->s->ng)) * measure;
    if (!(p > 0)) return;
    bins->expected[bin(bins, w)] += p;
    bins->total += p;
}

/* Chi-square of n samples against the density, lost ones in a bin of their own, as a normal deviate (Wilson and Hilferty).
 * *total: the integral of the density; *lost: the share of lost samples. */
static double compare_samples(const Surface *s, Vec3 known, Sample *sample, Density *density, int n, uint64_t seed, double *total, double *lost)
{
    Bins bins = bins_of(s, known, density);
    double count[BINS] = { 0 };
    quadrature(s, known, add_expected, &bins);
    Rng rng = rng_new(seed, 1);
    for (int i = 0; i < n; i++) {
        Vec3 w;
        Mode mode;
        count[sample(s, known, &rng, &w, &mode) ? bin(&bins, w) : LOST]++;
    }
    *total = bins.total;
    *lost = count[LOST] / n;
    bins.expected[LOST] = fmax(0, 1 - bins.total);
    double chi2 = 0, o = 0, e = 0;
    int df = -1;
    for (int i = 0; i < BINS; i++) {
        o += count[i];
        e += bins.expected[i] * n;
        if (e < 20 && i < LOST - 1) continue;                      /* thin bins are pooled; what is lost stands alone */
        chi2 += (o - e) * (o - e) / fmax(e, 1);                    /* fmax: what rounding of the quadrature leaves */
        df += e >= 1;
        o = e = 0;
    }
    if (df < 1) return chi2 < 1 ? 0 : INFINITY;                     /* everything in one bin */
    return chi_square_deviate(chi2, df);
}

static const Material diffuse[] = {
    { .name = "lambert", .kd = { 0.7, 0.5, 0.2 } },
    { .name = "phong 0", .ks = { 0.5, 0.6, 0.7 }, .ns = 0 },
    { .name = "phong 1", .ks = { 0.5, 0.6, 0.7 }, .ns = 1 },
    { .name = "phong 10", .ks = { 0.5, 0.6, 0.7 }, .ns = 10 },
    { .name = "phong 1000", .ks = { 0.5, 0.6, 0.7 }, .ns = 1000 },
    { .name = "phong 1e6", .ks = { 0.5, 0.6, 0.7 }, .ns = 1e6 },
    { .name = "mixture 0", .kd = { 0.5, 0.1, 0.2 }, .ks = { 0.1, 0.4, 0.3 }, .ns = 0 },
    { .name = "mixture 10", .kd = { 0.5, 0.1, 0.2 }, .ks = { 0.1, 0.4, 0.3 }, .ns = 10 },
    { .name = "mixture 1000", .kd = { 0.1, 0.3, 0.6 }, .ks = { 0.2, 0.4, 0.3 }, .ns = 1000 },
    { .name = "mixture 1e6", .kd = { 0.3, 0.3, 0.3 }, .ks = { 0.4, 0.4, 0.4 }, .ns = 1e6 },
    { .name = "textured", .kd = { 0, 0, 0 }, .ks = { 0.4, 0.4, 0.4 }, .ns = 30 },      /* kd comes from the surface */
};
enum { DIFFUSE = sizeof diffuse / sizeof diffuse[0], TILTS = 3, KNOWN = 4 };
static const double tilts[TILTS] = { 0, 0.3, 0.9 };

static Surface diffuse_surface(int m, int tilt)
{
    Surface s = surface_of(&diffuse[m], tilts[tilt]);
    if (m == DIFFUSE - 1) s.kd = vec3(0.05, 0.55, 0.25);
    return s;
}

/* Known directions about n_g, front and back, that lie on the same side of n_s. */
static bool known_direction(const Surface *s, int i, Vec3 *known)
{
    static const double theta[KNOWN] = { 0.1, 0.9, 1.4, PI - 0.7 };
    Vec3 a, b, local = polar(theta[i], 1 + i);
    frame(s->ng, &a, &b);
    *known = normalize(add(scale(local.x, a), add(scale(local.y, b), scale(local.z, s->ng))));
    return dot(*known, s->ns) * dot(*known, s->ng) > 0;
}

static void test_densities(void)
{
    double worst_z = 0, worst_lost = 0, worst_flat = 0;
    int compared = 0, off_caught = 0, cosine_caught = 0, off = 0, cosine = 0, geometric = 0, geometric_caught = 0, again = 0, again_caught = 0;
    for (int m = 0; m < DIFFUSE; m++)
        for (int t = 0; t < TILTS; t++)
            for (int k = 0; k < KNOWN; k++) {
                Surface s = diffuse_surface(m, t);
                Vec3 known;
                if (!known_direction(&s, k, &known)) continue;
                enum { N = 60000 };
                uint64_t seed = (uint64_t)(m * 100 + t * 10 + k);
                double total, lost, unused, z = compare_samples(&s, known, bsdf_sample, bsdf_pdf_pw, N, seed, &total, &lost);
                compared++;
                worst_z = fmax(worst_z, z);
                if (!CHECK(z < DEVIATE))
                    printf("  %s, tilt %g, known %d: deviate %.1f, integral %.6f, lost %.6f\n", diffuse[m].name, tilts[t], k, z, total, lost);
                /* the integral is what is not lost: sampling error of 'lost', and of the quadrature at the edges where the sides end */
                double allowed = DEVIATE * sqrt(fmax(lost * (1 - lost), 1.0 / N) / N) + 5e-4;
                worst_lost = fmax(worst_lost, fabs(1 - lost - total));
                CHECK_NEAR(total, 1 - lost, allowed);
                if (t == 0 && max3(diffuse[m].ks) == 0) {          /* a cosine lobe loses nothing */
                    worst_flat = fmax(worst_flat, fabs(total - 1));
                    CHECK_NEAR(total, 1, 1e-9);
                    CHECK(lost == 0);
                }
                if (k != 1 || lost > 0.2) continue;
                off++;
                compare_samples(&s, known, bsdf_sample, density_off, N, seed, &total, &lost);
                off_caught += fabs(total - (1 - lost)) > allowed;
                cosine++;
                cosine_caught += compare_samples(&s, known, bsdf_sample, density_without_cosine, N, seed, &unused, &unused) > 2 * DEVIATE;
                if (t > 0) {
                    geometric++;
                    geometric_caught += compare_samples(&s, known, bsdf_sample, density_geometric, N, seed, &unused, &unused) > 2 * DEVIATE;
                }
                if (lost > 0.02) {
                    again++;
                    again_caught += compare_samples(&s, known, sample_again, bsdf_pdf_pw, N, seed, &unused, &unused) > 2 * DEVIATE;
                }
            }
    printf("densities: %d surfaces, worst deviate %.2f, worst |integral - (1 - lost)| %.1e, without loss %.1e\n"
           "  planted: 2 %% off %d of %d, cosine %d of %d, n_g for n_s %d of %d, lost redrawn %d of %d\n",
           compared, worst_z, worst_lost, worst_flat, off_caught, off, cosine_caught, cosine, geometric_caught, geometric, again_caught, again);
    CHECK(off > DIFFUSE && off_caught == off);
    CHECK(cosine_caught == cosine);
    CHECK(geometric_caught == geometric);
    CHECK(again > 3 && again_caught == again);
}

/* p|cos_g| = P |cos_s|/pi + (1-P) (n+1)/(2 pi) cos^n, P a number that depends on the point and the known direction only: found from one
 * direction, it must explain all others. */
static void test_lobes(void)
{
    double worst = 0;
    Rng rng = rng_new(2, 2);
    for (int m = 0; m < DIFFUSE; m++)
        for (int t = 0; t < TILTS; t++)
            for (int k = 0; k < KNOWN; k++) {
                Surface s = diffuse_surface(m, t);
                Vec3 known, mirror;
                if (!known_direction(&s, k, &known)) continue;
                mirror = sub(scale(2 * dot(known, s.ns), s.ns), known);
                double P = NAN, n = s.material->ns;
                for (int i = 0; i < 400; i++) {
                    Vec3 w = anywhere(&rng);
                    if (i % 2) w = normalize(add(mirror, scale(2 * rng_double(&rng) / sqrt(n + 1), w)));   /* within the lobe */
                    bool seen = dot(w, s.ng) * dot(known, s.ng) > 0 && dot(w, s.ns) * dot(known, s.ng) > 0;
                    double p_w = bsdf_pdf_pw(&s, known, w) * fabs(dot(w, s.ng)), cosine = dot(w, mirror);
                    if (!seen) { CHECK(p_w == 0); continue; }
                    double flat = fabs(dot(w, s.ns)) / PI, lobe = cosine > 0 ? (n + 1) / (2 * PI) * pow(cosine, n) : 0;
                    if (!(fabs(flat - lobe) > 1e-2 * (flat + lobe))) continue;
                    if (isnan(P)) P = (p_w - lobe) / (flat - lobe);
                    check_worse(&worst, fabs(p_w - (P * flat + (1 - P) * lobe)) / (flat + lobe));
                }
                CHECK(P >= -1e-9 && P <= 1 + 1e-9);
                if (max3(s.material->ks) == 0) CHECK_NEAR(P, 1, 1e-9);
            }
    printf("lobes: worst difference %.1e\n", worst);
    CHECK_NEAR(worst, 0, 1e-7);
}

/* F, S> and S< against the formulas; the same f_s from either side but for the shading normals' factor. */
static void test_scatter(void)
{
    double worst = 0, worst_reciprocal = 0, planted = 0;
    int passed = 0, blocked = 0;
    Rng rng = rng_new(3, 3);
    for (int m = 0; m < DIFFUSE; m++)
        for (int t = 0; t < TILTS; t++)
            for (int i = 0; i < 4000; i++) {
                Surface s = diffuse_surface(m, t);
                Vec3 wl = anywhere(&rng), we = anywhere(&rng);
                if (i % 2) we = normalize(add(sub(scale(2 * dot(wl, s.ns), s.ns), wl), scale(rng_double(&rng) / sqrt(s.material->ns + 1), we)));
                Scatter a, b;
                RefScatter r = ref_scatter(&s, wl, we, MODE_NONE, FAULT_NONE);
                bool ok = bsdf_scatter(&s, wl, we, MODE_NONE, &a), back = bsdf_scatter(&s, we, wl, MODE_NONE, &b);
                CHECK(ok == back);                                 /* both directions are tested for both sides */
                if (!ok) { CHECK(!(r.F > 1e-99L)); blocked++; continue; }
                passed++;
                CHECK(r.passes && a.q == 1);
                CHECK(!bsdf_scatter(&s, wl, we, MODE_REFLECT, &b) && !bsdf_scatter(&s, wl, we, MODE_REFRACT, &b));
                double d = relative(r.F, 1 / a.inv_F);
                check_worse(&d, relative(r.p_lens / r.F, a.inv_S_lens));
                check_worse(&d, relative(r.p_light / r.F, a.inv_S_light));
                double colour[3] = { a.colour.x, a.colour.y, a.colour.z };
                for (int c = 0; c < 3; c++) check_worse(&d, (double)ref_abs(r.f[c] / r.F - colour[c]));
                check_worse(&worst, d / (1 + 1e-3 * s.material->ns));   /* cos^n magnifies rounding n-fold */
                /* f_s(L,E) = f_s(E,L); F differs by |w.n_s|/|w.n_g| of its own light side */
                bsdf_scatter(&s, we, wl, MODE_NONE, &b);
                double normals = fabs(dot(wl, s.ns) * dot(we, s.ng) / (dot(wl, s.ng) * dot(we, s.ns)));
                check_worse(&worst_reciprocal, relative(b.inv_F / a.inv_F, normals) / (1 + 1e-3 * s.material->ns));
                if (t > 0) planted = fmax(planted, relative(b.inv_F / a.inv_F, 1));
                if (t == 0) CHECK(relative(a.inv_S_lens, b.inv_S_light) < 1e-9 * (1 + s.material->ns));   /* roles exchanged */
            }
    printf("scatter: %d pairs pass, %d do not; worst %.1e, reciprocity %.1e (planted: factor left out %.2g)\n",
           passed, blocked, worst, worst_reciprocal, planted);
    CHECK(passed > 10000 && blocked > 10000);
    CHECK_NEAR(worst, 0, 1e-11);
    CHECK_NEAR(worst_reciprocal, 0, 1e-11);
    CHECK(planted > 0.1);
}

/* ---- energy ---- */

typedef struct { const Surface *s; Vec3 lens; double albedo[3]; double fault; } Albedo;
static void add_albedo(void *context, Vec3 w, double measure)
{
    Albedo *a = context;
    RefScatter r = ref_scatter(a->s, w, a->lens, MODE_NONE, FAULT_NONE);
    if (!r.passes) return;
    for (int c = 0; c < 3; c++) a->albedo[c] += (double)r.f[c] * fabs(dot(w, a->s->ng)) * measure * a->fault;
}

/* A single bounce in a white furnace: the mean of S< colour over samples is the albedo by quadrature, and at most kd + ks <= 1. */
static void test_energy(void)
{
    double worst_z = 0, most = 0, lambert = 0;
    int caught = 0, all = 0;
    for (int m = 0; m < DIFFUSE; m++)
        for (int t = 0; t < TILTS; t++)
            for (int k = 0; k < KNOWN; k++) {
                Surface s = diffuse_surface(m, t);
                Vec3 known;
                if (!known_direction(&s, k, &known)) continue;
                Albedo a = { &s, known, { 0 }, 1 };
                quadrature(&s, known, add_albedo, &a);
                double limit[3] = { s.kd.x + s.material->ks.x, s.kd.y + s.material->ks.y, s.kd.z + s.material->ks.z };
                for (int c = 0; c < 3; c++) {
                    most = fmax(most, a.albedo[c] - limit[c]);
                    /* n+2 over n+1 at a lobe that the cosine does not weaken: a modified Phong lobe reflects ks at most, at normal incidence */
                    CHECK(a.albedo[c] <= limit[c] + 5e-4);
                    if (m == 0 && t == 0) check_worse(&lambert, fabs(a.albedo[c] - limit[c]));
                }
                CHECK(bsdf_albedo(&s) >= fmax(a.albedo[0], fmax(a.albedo[1], a.albedo[2])) - 5e-4 && bsdf_albedo(&s) <= 1);
                enum { N = 40000 };
                double sum = 0, square = 0;
                Rng rng = rng_new((uint64_t)(m * 100 + t * 10 + k), 6);
                for (int i = 0; i < N; i++) {
                    Vec3 w;
                    Mode mode;
                    Scatter x;
                    double value = 0;
                    if (bsdf_sample(&s, known, &rng, &w, &mode) && bsdf_scatter(&s, w, known, mode, &x)) value = x.colour.y / x.inv_S_light;
                    sum += value / N;
                    square += value * value / N;
                }
                double error = sqrt(fmax(square - sum * sum, 0) / N) + 2e-4, z = fabs(sum - a.albedo[1]) / error;
                worst_z = fmax(worst_z, z);
                if (!CHECK(z < DEVIATE))
                    printf("  %s, tilt %g, known %d: %.6f by samples, %.6f by quadrature\n", diffuse[m].name, tilts[t], k, sum, a.albedo[1]);
                all++;
                caught += fabs(sum - 1.05 * a.albedo[1]) / error > DEVIATE;
            }
    printf("energy: worst deviate %.2f, Lambert off by %.1e, most above kd + ks %.1e; planted: 5 %% too bright %d of %d\n",
           worst_z, lambert, most, caught, all);
    CHECK(lambert < 1e-9);
    CHECK(caught * 10 >= all * 8);
}

/* ---- Fresnel ---- */

static void test_fresnel(void)
{
    static const double eta[] = { 0.7, 1 / 1.5, 1 / 1.33, 1.0000001, 1.33, 1.5, 2.4 };
    double worst = 0, cos_t;
    for (size_t i = 0; i < sizeof eta / sizeof eta[0]; i++) {
        double n = eta[i], normal = pow((n - 1) / (n + 1), 2), brewster = atan(n);
        CHECK_NEAR(bsdf_fresnel(1, n, &cos_t), normal, 1e-14);
        CHECK_NEAR(cos_t, 1, 1e-14);
        /* Brewster: reflected and refracted at right angles, one polarisation only: half of ((1-n^2)/(1+n^2))^2 */
        CHECK_NEAR(bsdf_fresnel(cos(brewster), n, &cos_t), pow((1 - n * n) / (1 + n * n), 2) / 2, 1e-13);
        CHECK_NEAR(cos_t, sin(brewster), 1e-13);
        for (int j = 1; j < 1000; j++) {
            /* Fresnel's sine and tangent laws */
            double ti = PI / 2 * j / 1000, st = sin(ti) / n, R = bsdf_fresnel(cos(ti), n, &cos_t);
            if (st >= 1) {
                CHECK(R == 1 && cos_t == 0);
                continue;
            }
            double tt = asin(st), rs = sin(ti - tt) / sin(ti + tt), rp = tan(ti - tt) / tan(ti + tt);
            if (fabs(n - 1) > 1e-3) check_worse(&worst, fabs(R - (rs * rs + rp * rp) / 2));
            check_worse(&worst, fabs(cos_t - cos(tt)) * cos(tt));
            /* Stokes: the same from the other side */
            double back;
            check_worse(&worst, fabs(bsdf_fresnel(cos_t, 1 / n, &back) - R));
        }
    }
    CHECK(bsdf_fresnel(0.5, 1, &cos_t) == 0);
    CHECK_NEAR(cos_t, 0.5, 1e-15);
    CHECK_NEAR(bsdf_fresnel(cos(PI / 3), 1.5, &cos_t), 0.0891867, 1e-7);     /* textbook value for glass at 60 degrees */
    CHECK_NEAR(bsdf_fresnel(1, 1.5, &cos_t), 0.04, 1e-15);
    CHECK_NEAR(bsdf_fresnel(1e-9, 1.5, &cos_t), 1, 1e-8);                     /* grazing */
    printf("Fresnel: worst %.1e\n", worst);
    CHECK_NEAR(worst, 0, 1e-11);
}

/* ---- mirror and glass ---- */

static const Material specular[] = {
    { .name = "mirror", .kind = MATERIAL_MIRROR, .ks = { 0.8, 0.9, 0.5 }, .ni = 1 },
    { .name = "glass 0.7", .kind = MATERIAL_GLASS, .tf = { 0.9, 0.8, 0.4 }, .ni = 0.7 },
    { .name = "glass 1", .kind = MATERIAL_GLASS, .tf = { 0.9, 0.8, 0.4 }, .ni = 1 },
    { .name = "glass 1.33", .kind = MATERIAL_GLASS, .tf = { 1, 1, 1 }, .ni = 1.33 },
    { .name = "glass 1.5", .kind = MATERIAL_GLASS, .tf = { 0.3, 0.8, 0.4 }, .ni = 1.5 },
};
enum { SPECULAR = sizeof specular / sizeof specular[0] };

/* Directions obey the law of the mode, S carries rho/q times eta^2 and the normals' factor, drawn and copied differ by q. */
static void test_specular(void)
{
    double law = 0, back_error = 0, ratio = 0, copied = 0, no_eta = 0, no_normals = 0, worst_mode = 0;
    int total_reflection = 0, followed = 0, modes = 0, caught = 0;
    Rng rng = rng_new(8, 8);
    for (int m = 0; m < SPECULAR; m++)
        for (int t = 0; t < TILTS; t++)
            for (int i = 0; i < 3000; i++) {
                Surface s = surface_of(&specular[m], tilts[t]);
                Vec3 known = anywhere(&rng), w;
                double ks = dot(known, s.ns), kg = dot(known, s.ng), n_known = kg > 0 ? 1 : s.material->ni, n_beyond = kg > 0 ? s.material->ni : 1;
                if (ks * kg <= 0 || fabs(ks) < 1e-3 || fabs(kg) < 1e-3) continue;
                double sin_t = n_known / n_beyond * sqrt(1 - ks * ks);
                for (Mode mode = MODE_REFLECT; mode <= MODE_REFRACT; mode++) {
                    bool exists = mode == MODE_REFLECT || (s.material->kind == MATERIAL_GLASS && sin_t < 1);
                    bool ok = bsdf_follow(&s, known, mode, &w);
                    if (!exists) { CHECK(!ok); total_reflection += s.material->kind == MATERIAL_GLASS; continue; }
                    /* where n_s sends it to the wrong side of n_g, nothing passes; bsdf_follow may say so or leave it to bsdf_scatter */
                    Vec3 expect = mode == MODE_REFLECT ? sub(scale(2 * ks, s.ns), known)
                                : sub(scale(-n_known / n_beyond, sub(known, scale(ks, s.ns))), scale(copysign(sqrt((1 - sin_t) * (1 + sin_t)), ks), s.ns));
                    double eg = dot(expect, s.ng), es = dot(expect, s.ns);
                    bool right_side = eg * es > 0 && (eg * kg > 0) == (mode == MODE_REFLECT);
                    Scatter a, b;
                    if (!right_side) {
                        if (fabs(eg) > 1e-6) CHECK(!ok || !bsdf_scatter(&s, known, w, mode, &a));
                        continue;
                    }
                    if (fabs(eg) < 1e-3 || fabs(es) < 1e-3) continue;
                    if (!CHECK(ok)) continue;
                    followed++;
                    check_worse(&law, length(sub(w, expect)));
                    /* Snell: n sin the same on both sides, in one plane */
                    if (mode == MODE_REFRACT) check_worse(&law, length(add(scale(n_known, cross(s.ns, known)), scale(n_beyond, cross(s.ns, w)))));
                    Vec3 back;
                    if (CHECK(bsdf_follow(&s, w, mode, &back))) check_worse(&back_error, length(sub(back, known)) * fabs(ks));
                    /* known as the light side, then as the lens side */
                    for (int side = 0; side < 2; side++) {
                        Vec3 wl = side ? w : known, we = side ? known : w;
                        RefScatter r = ref_scatter(&s, wl, we, mode, FAULT_NONE), e = ref_scatter(&s, wl, we, mode, FAULT_NO_ETA),
                                   n = ref_scatter(&s, wl, we, mode, FAULT_NO_NORMALS);
                        bool passes = bsdf_scatter(&s, wl, we, mode, &a);
                        if (r.F < 1e-12L) continue;                 /* equal indices do not reflect */
                        if (!CHECK(passes && r.passes)) continue;
                        CHECK(a.inv_F == 0);                        /* cannot be joined */
                        check_worse(&ratio, relative(r.p_lens * r.q / r.F, a.inv_S_lens));
                        check_worse(&ratio, relative(r.p_light * r.q / r.F, a.inv_S_light));
                        check_worse(&ratio, relative(r.q, a.q));
                        double colour[3] = { a.colour.x, a.colour.y, a.colour.z };
                        for (int c = 0; c < 3; c++) check_worse(&ratio, (double)ref_abs(r.f[c] / r.F - colour[c]));
                        no_eta = fmax(no_eta, relative(e.p_light * e.q / e.F, a.inv_S_light));
                        if (t > 0) no_normals = fmax(no_normals, relative(n.p_lens * n.q / n.F, a.inv_S_lens));
                        /* 1/S of a copied mode has q = 1 */
                        check_worse(&copied, relative(r.p_lens / r.F, a.inv_S_lens / a.q));
                        CHECK(!bsdf_scatter(&s, wl, we, mode == MODE_REFLECT ? MODE_REFRACT : MODE_REFLECT, &b));
                        CHECK(!bsdf_scatter(&s, wl, we, MODE_NONE, &b));
                        if (t == 0 && s.material->kind == MATERIAL_GLASS)   /* n_s = n_g: S> = rho/q, the tint under a Fresnel choice */
                            CHECK_NEAR(1 / a.inv_S_lens, mode == MODE_REFLECT ? 1 : max3(s.material->tf), 1e-9);
                    }
                }
                /* how often a mode is drawn */
                if (i >= 12) continue;
                enum { N = 20000 };
                int reflected = 0, lost = 0, elsewhere = 0;
                Vec3 mirror, through;
                bool can_reflect = bsdf_follow(&s, known, MODE_REFLECT, &mirror), can_refract = bsdf_follow(&s, known, MODE_REFRACT, &through);
                for (int j = 0; j < N; j++) {
                    Mode mode;
                    if (!bsdf_sample(&s, known, &rng, &w, &mode)) { lost++; continue; }
                    reflected += mode == MODE_REFLECT;
                    elsewhere += !(mode == MODE_REFLECT && can_reflect && length(sub(w, mirror)) < 1e-12)
                              && !(mode == MODE_REFRACT && can_refract && length(sub(w, through)) < 1e-12);
                }
                CHECK(elsewhere == 0);
                if (lost) continue;                                 /* the lost mode is not told */
                modes++;
                double q = s.material->kind == MATERIAL_MIRROR ? 1 : (double)ref_fresnel(n_known, n_beyond, fabs(ks)), expected = q * N;
                double z = fabs(reflected - expected) / sqrt(fmax(expected * (1 - q), 1)), wrong = fabs(N / 2.0 - expected) / sqrt(N / 4.0);
                worst_mode = fmax(worst_mode, z);
                caught += wrong > DEVIATE;                          /* planted: modes drawn half and half */
                CHECK(z < DEVIATE);
            }
    printf("specular: %d directions, law %.1e, back %.1e, S %.1e, copied %.1e, modes' deviate %.2f; "
           "planted: eta^2 %.2g, normals %.2g, half and half %d of %d\n", followed, law, back_error, ratio, copied, worst_mode, no_eta, no_normals, caught, modes);
    CHECK(followed > 20000 && total_reflection > 100 && modes > 50);
    CHECK_NEAR(law, 0, 1e-12);
    CHECK_NEAR(back_error, 0, 1e-11);
    CHECK_NEAR(ratio, 0, 1e-9);
    CHECK_NEAR(copied, 0, 1e-9);
    CHECK(no_eta > 0.1 && no_normals > 0.1);
    CHECK(caught * 10 >= modes * 9);
}

/* dw_out/dw_in by finite differences of bsdf_follow, against S>/S<: the two densities of one specular vertex describe the same beam.
 *     p>/p< = S</S> = (|w_L.n_g| / |w_E.n_g|) dw_L/dw_E */
static void test_jacobian(void)
{
    double worst = 0, planted = 0;
    int compared = 0;
    Rng rng = rng_new(9, 1);
    for (int m = 0; m < SPECULAR; m++)
        for (int t = 0; t < TILTS; t++)
            for (int i = 0; i < 400; i++) {
                Surface s = surface_of(&specular[m], tilts[t]);
                Vec3 wl = anywhere(&rng), we, a, b, p[4];
                Mode mode = i % 2 ? MODE_REFRACT : MODE_REFLECT;
                Scatter x;
                if (!bsdf_follow(&s, wl, mode, &we) || !bsdf_scatter(&s, wl, we, mode, &x)) continue;
                if (fabs(dot(wl, s.ns)) < 0.1 || fabs(dot(we, s.ns)) < 0.1) continue;
                const double h = 1e-4;
                frame(wl, &a, &b);
                bool ok = bsdf_follow(&s, normalize(along(wl, h, a)), mode, &p[0]) && bsdf_follow(&s, normalize(along(wl, -h, a)), mode, &p[1])
                       && bsdf_follow(&s, normalize(along(wl, h, b)), mode, &p[2]) && bsdf_follow(&s, normalize(along(wl, -h, b)), mode, &p[3]);
                if (!ok) continue;
                double beam = length(cross(sub(p[0], p[1]), sub(p[2], p[3]))) / (4 * h * h);    /* dw_E/dw_L */
                double expected = fabs(dot(wl, s.ng) / dot(we, s.ng)) / beam, got = x.inv_S_lens / x.inv_S_light;
                check_worse(&worst, relative(expected, got));
                planted = fmax(planted, relative(1 / beam, got));                                /* the normals' cosines left out */
                compared++;
            }
    printf("beams: %d, worst %.1e; planted %.2g\n", compared, worst, planted);
    CHECK(compared > 1000);
    CHECK_NEAR(worst, 0, 1e-4);        /* second differences in h */
    CHECK(planted > 0.1);
}

/* A unit vector near w. */
static Vec3 beside(Vec3 w, double most, Rng *rng) { return normalize(along(w, most, anywhere(rng))); }

/* Directions copied from another point: in a narrow lobe by a rotation (angles stay as they are), there and back; by a mode as bsdf_follow says. */
static void test_pass(void)
{
    const Material metal = { .name = "metal", .ks = { 0.5, 0.5, 0.5 }, .ns = 400 }, broad = { .name = "broad", .ks = { 0.5, 0.5, 0.5 }, .ns = 20 };
    double off = 0, apart = 0, back = 0, planted = 0;
    int passed = 0;
    Rng rng = rng_new(11, 1);
    for (int t = 0; t < TILTS; t++)
        for (int i = 0; i < 3000; i++) {
            Surface there = surface_of(&metal, tilts[t]), here = surface_of(&metal, tilts[(t + i) % TILTS]);
            Vec3 known_there = anywhere(&rng), known = beside(known_there, i % 3 * 0.5, &rng), m = bsdf_mirrored(&there, known_there), w, w2, again;
            Passage one = bsdf_passage(&there, known_there, beside(m, 0.1, &rng), MODE_NONE), two = bsdf_passage(&there, known_there, beside(m, 0.1, &rng), MODE_NONE);
            if (!bsdf_pass(&here, known, &one, &w) || !bsdf_pass(&here, known, &two, &w2)) continue;
            Vec3 m_here = bsdf_mirrored(&here, known);
            check_worse(&off, fabs(length(sub(w, m_here)) - length(sub(one.w, m))));
            check_worse(&apart, fabs(length(sub(w, w2)) - length(sub(one.w, two.w))));
            Passage home = bsdf_passage(&here, known, w, MODE_NONE);
            if (CHECK(bsdf_pass(&there, known_there, &home, &again))) check_worse(&back, length(sub(again, one.w)));
            planted = fmax(planted, fabs(length(sub(one.w, w2)) - length(sub(one.w, two.w))));     /* one of the two not rotated */
            passed++;
        }
    printf("copied places in a lobe: %d, off the mirror image %.1e, apart %.1e, back %.1e; planted %.2g\n", passed, off, apart, back, planted);
    CHECK(passed > TILTS * 1000);
    CHECK_NEAR(off, 0, 1e-12);
    CHECK_NEAR(apart, 0, 1e-12);
    CHECK_NEAR(back, 0, 1e-9);         /* a large turn divides by a small 1 + a.b */
    CHECK(planted > 0.01);
    Surface s = surface_of(&broad, 0), mirror = surface_of(&specular[0], 0);
    Vec3 known = normalize(along(s.ng, 0.4, vec3(0.6, 0.8, 0))), w, followed;
    Passage lobe = bsdf_passage(&s, known, bsdf_mirrored(&s, known), MODE_NONE), mode = { .mode = MODE_REFLECT };
    CHECK(!bsdf_pass(&s, known, &lobe, &w));
    CHECK(!bsdf_pass(&mirror, known, &lobe, &w));
    if (CHECK(bsdf_pass(&mirror, known, &mode, &w) && bsdf_follow(&mirror, known, MODE_REFLECT, &followed))) CHECK_NEAR(length(sub(w, followed)), 0, 0);
}

/* bsdf_pass_change against differences of bsdf_pass, the known direction and the normal both changing. */
static void test_pass_change(void)
{
    const Material metal = { .name = "metal", .ks = { 0.5, 0.5, 0.5 }, .ns = 400 };
    double worst = 0, planted = 0;
    int compared = 0;
    Rng rng = rng_new(12, 1);
    for (int m = -1; m < SPECULAR; m++)
        for (int i = 0; i < 2000; i++) {
            Surface s = surface_of(m < 0 ? &metal : &specular[m], tilts[i % TILTS]), changed[2] = { s, s };
            Vec3 known = anywhere(&rng), from = beside(known, 0.5, &rng), a, b, w, end[2];
            Passage passage = bsdf_passage(&s, from, beside(bsdf_mirrored(&s, from), 0.1, &rng), m < 0 ? MODE_NONE : i % 2 ? MODE_REFRACT : MODE_REFLECT);
            if (!bsdf_pass(&s, known, &passage, &w) || fabs(dot(known, s.ns)) < 0.1 || fabs(dot(w, s.ns)) < 0.1) continue;
            const double h = 1e-5;
            frame(known, &a, &b);
            Vec3 d_known = along(scale(0.3, a), 0.7, b);
            frame(s.ns, &a, &b);
            Vec3 d_ns = along(scale(0.8, a), -0.5, b);
            bool ok = true;
            for (int j = 0; j < 2; j++) {
                double step = j ? -h : h;
                changed[j].ns = normalize(along(s.ns, step, d_ns));
                ok = ok && bsdf_pass(&changed[j], normalize(along(known, step, d_known)), &passage, &end[j]);
            }
            if (!ok) continue;
            Vec3 measured = scale(1 / (2 * h), sub(end[0], end[1])), told = bsdf_pass_change(&s, known, &passage, d_known, d_ns);
            const Passage mirror = { .mode = MODE_REFLECT };
            double large = 1 + length(measured);
            check_worse(&worst, length(sub(measured, told)) / large);
            if (m < 0) planted = fmax(planted, length(sub(measured, bsdf_pass_change(&s, known, &mirror, d_known, d_ns))) / large);   /* as at a mirror */
            compared++;
        }
    printf("changes of what is copied: %d, worst %.1e; planted %.2g\n", compared, worst, planted);
    CHECK(compared > 2000);
    CHECK_NEAR(worst, 0, 1e-6);
    CHECK(planted > 0.01);
}

/* Black surfaces scatter nothing; a cosine sample is what it says. */
static void test_ends(void)
{
    Material black = { .name = "black" };
    Surface s = surface_of(&black, 0);
    Scatter a;
    CHECK(!bsdf_scatter(&s, s.ng, normalize(along(s.ng, 0.3, vec3(1, 0, 0))), MODE_NONE, &a));
    Vec3 w;
    CHECK(!bsdf_follow(&s, s.ng, MODE_REFLECT, &w));
    Rng rng = rng_new(1, 2);
    enum { N = 100000 };
    const double mean_allowed = DEVIATE * sqrt(1.0 / 18 / N), square_allowed = DEVIATE * sqrt(1.0 / 12 / N);
    for (int uniform = 0; uniform < 2; uniform++) {
        Vec3 sum = vec3(0, 0, 0);
        double square = 0;
        for (int i = 0; i < N; i++) {
            w = uniform ? anywhere(&rng) : sample_cosine(s.ng, &rng);
            if (uniform && dot(w, s.ng) < 0) w = neg(w);
            sum = add(sum, scale(1.0 / N, w));
            square += pow(dot(w, s.ng), 2) / N;
        }
        if (uniform) {                                             /* planted: uniform over the hemisphere */
            CHECK(fabs(dot(sum, s.ng) - 2.0 / 3) > mean_allowed && fabs(square - 0.5) > square_allowed);
            continue;
        }
        CHECK_NEAR(dot(sum, s.ng), 2.0 / 3, mean_allowed);         /* mean and second moment of a cosine law */
        CHECK_NEAR(square, 0.5, square_allowed);
        CHECK_NEAR(length(sub(sum, scale(2.0 / 3, s.ng))), 0, DEVIATE / sqrt(N));
    }
}

/* Far out in a narrow lobe f falls through the smallest numbers that there are. What is scattered there at all has finite ratios, and of products as long as
 * those of a path's join too. */
static void test_tail(void)
{
    const Material narrow = { .name = "phong 20000", .ks = { 0.9, 0.5, 0.2 }, .ns = 20000 };
    Surface s = surface_of(&narrow, 0);
    Vec3 a, b, known = s.ng;
    int passed = 0, dark = 0;
    frame(s.ng, &a, &b);
    for (int i = 0; i <= 200000; i++) {
        double theta = 0.4 * i / 200000;                           /* cos^20000 is 1e-700 at the end */
        Vec3 w = along(scale(sin(theta), a), cos(theta), s.ng);
        Scatter out;
        if (!bsdf_scatter(&s, known, w, MODE_NONE, &out)) { dark++; continue; }
        passed++;
        CHECK(isfinite(out.inv_F * out.inv_F * out.inv_F) && isfinite(out.inv_S_lens) && isfinite(out.inv_S_light) && finite3(out.colour));
        CHECK(max3(out.colour) <= 1 + 1e-12);
    }
    printf("tail of a narrow lobe: %d directions pass, %d do not\n", passed, dark);
    CHECK(passed > 1000 && dark > 1000);
}

int main(void)
{
    test_tail();
    test_densities();
    test_lobes();
    test_scatter();
    test_energy();
    test_fresnel();
    test_specular();
    test_jacobian();
    test_pass();
    test_pass_change();
    test_ends();
    return check_report();
}
