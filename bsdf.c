/* Scattering at one surface point. See bsdf.h for directions, measures and what the ratios mean.
 *
 * Lambert     f = kd / pi
 * Phong       f = ks (n+2)/(2 pi) cos^n a,  a between w_lens and the mirror image of w_light (symmetric); sampled with (n+1)/(2 pi) cos^n a
 * Mirror      tint ks
 * Dielectric  exact Fresnel; radiance scales by (eta_lens/eta_light)^2 across the interface [Veach ch. 5]
 */
#include "bsdf.h"

static const double NOTHING = 1e-100;          /* f far out in a lobe: inverses, and products of a few, stay finite */

static double side(Vec3 w, const Surface *s, double *cos_s)
{
    double cos_g = dot(w, s->ng);
    *cos_s = dot(w, s->ns);
    return cos_g * *cos_s > 0 ? cos_g : 0;
}

/* cos^n of the angle between w and the mirror image of v about n_s, 0 beyond a right angle (for n = 0 too: the lobe is a hemisphere). */
static double phong_power(const Surface *s, Vec3 v, Vec3 w, double cos_v)
{
    double c = 2 * cos_v * dot(w, s->ns) - dot(v, w);
    if (c <= 0) return 0;
    return c >= 1 ? 1 : pow(c, s->material->ns);
}

/* Probability of the diffuse lobe: depends on the point only, so the mixture is the same seen from both ends. */
static double diffuse_prob(const Surface *s)
{
    double d = max3(s->kd), p = max3(s->material->ks);
    return p > 0 ? d / (d + p) : 1;
}

double bsdf_pdf_pw(const Surface *s, Vec3 known, Vec3 w)
{
    double known_s, w_s, known_g = side(known, s, &known_s), w_g = side(w, s, &w_s);
    if (known_g * w_g <= 0) return 0;
    double d = diffuse_prob(s), n = s->material->ns;
    double pdf_w = d * fabs(w_s) / PI;
    if (d < 1) pdf_w += (1 - d) * (n + 1) / (2 * PI) * phong_power(s, known, w, known_s);
    return pdf_w / fabs(w_g);
}

static bool scatter_diffuse(const Surface *s, double light_g, double light_s, double lens_g, double lens_s, Vec3 w_light, Vec3 w_lens, Scatter *out)
{
    const Material *m = s->material;
    if (light_g * lens_g <= 0) return false;
    double d = diffuse_prob(s), n = m->ns, lobe = 0;
    Rgb f = scale(1 / PI, s->kd);
    if (d < 1) {
        lobe = phong_power(s, w_light, w_lens, light_s) / (2 * PI);
        f = along(f, (n + 2) * lobe, m->ks);
    }
    double largest = max3(f);
    if (!(largest > NOTHING)) return false;
    double inv_light_g = 1 / fabs(light_g);
    double F = largest * fabs(light_s) * inv_light_g;
    out->inv_F = 1 / F;
    double phong_w = (1 - d) * (n + 1) * lobe;
    out->inv_S_light = (d * fabs(light_s) / PI + phong_w) * inv_light_g * out->inv_F;
    out->inv_S_lens = (d * fabs(lens_s) / PI + phong_w) / fabs(lens_g) * out->inv_F;
    out->colour = scale(1 / largest, f);
    out->q = 1;
    out->narrow = material_is_narrow(m) && PI * (n + 2) * lobe * max3(m->ks) > max3(s->kd);
    return isfinite(out->inv_F);
}

double bsdf_fresnel(double cos_i, double eta, double *cos_t)
{
    double sin_t2 = (1 - cos_i * cos_i) / (eta * eta);
    if (sin_t2 >= 1) { *cos_t = 0; return 1; }
    *cos_t = sqrt(1 - sin_t2);
    double parallel = (eta * cos_i - *cos_t) / (eta * cos_i + *cos_t);
    double normal = (cos_i - eta * *cos_t) / (cos_i + eta * *cos_t);
    return 0.5 * (parallel * parallel + normal * normal);
}

/* index beyond / index before, seen from the side on which a direction with this cosine to the front lies */
static double relative_index(const Material *m, double cosine) { return cosine > 0 ? m->ni : 1 / m->ni; }

bool bsdf_scatter(const Surface *s, Vec3 w_light, Vec3 w_lens, Mode mode, Scatter *out)
{
    const Material *m = s->material;
    double light_s, lens_s, light_g = side(w_light, s, &light_s), lens_g = side(w_lens, s, &lens_s);
    if (light_g == 0 || lens_g == 0) return false;
    if (m->kind == MATERIAL_DIFFUSE) return mode == MODE_NONE && scatter_diffuse(s, light_g, light_s, lens_g, lens_s, w_light, w_lens, out);
    if (mode == MODE_NONE || (light_g * lens_g > 0) != (mode == MODE_REFLECT)) return false;

    /* rho / q is the tint for a drawn Fresnel mode: the reflectance itself is the probability q */
    Rgb tint = m->kind == MATERIAL_MIRROR ? m->ks : mode == MODE_REFLECT ? vec3(1, 1, 1) : m->tf;
    double radiance_scale = 1, cos_t;
    out->q = 1;
    if (m->kind == MATERIAL_GLASS) {
        double eta = relative_index(m, light_s), reflectance = bsdf_fresnel(fabs(light_s), eta, &cos_t);
        out->q = mode == MODE_REFLECT ? reflectance : 1 - reflectance;
        if (mode == MODE_REFRACT) radiance_scale = eta * eta;   /* (eta_lens / eta_light)^2: light side before, lens side beyond */
    } else if (mode == MODE_REFRACT) return false;
    double largest = max3(tint);
    if (!(largest > 0) || !(out->q > 0)) return false;
    out->colour = scale(1 / largest, tint);
    out->inv_F = 0;
    out->narrow = false;
    out->inv_S_light = 1 / (largest * radiance_scale);
    out->inv_S_lens = fabs(light_g * lens_s / (lens_g * light_s)) / largest;
    return true;
}

/* A point of the unit disk, lifted to the hemisphere over it [Malley]. */
static Vec3 lift(Vec3 n, double x, double y)
{
    Vec3 a, b;
    frame(n, &a, &b);
    return along(along(scale(sqrt(larger(0, 1 - x * x - y * y)), n), x, a), y, b);
}

Vec3 sample_cosine(Vec3 n, Rng *rng)
{
    double x, y;
    rng_disk(rng, &x, &y);
    return lift(n, x, y);
}

static Vec3 turned(Vec3 w, double cosine, double sine, double x, double y, double squared)
{
    Vec3 a, b;
    double r = sine / sqrt(squared);
    frame(w, &a, &b);
    return along(along(scale(cosine, w), r * x, a), r * y, b);
}

Vec3 sample_turned(Vec3 w, double cosine, double sine, Rng *rng)
{
    double x, y, squared;
    do rng_disk(rng, &x, &y);
    while ((squared = x * x + y * y) == 0);
    return turned(w, cosine, sine, x, y, squared);
}

bool bsdf_follow(const Surface *s, Vec3 known, Mode mode, Vec3 *w)
{
    const Material *m = s->material;
    double known_s, w_s, cos_t, known_g = side(known, s, &known_s);
    if (known_g == 0 || !material_is_specular(m) || mode == MODE_NONE) return false;
    if (mode == MODE_REFLECT) {
        *w = bsdf_mirrored(s, known);
        return side(*w, s, &w_s) * known_g > 0;
    }
    if (m->kind != MATERIAL_GLASS) return false;
    double eta = relative_index(m, known_s);
    if (bsdf_fresnel(fabs(known_s), eta, &cos_t) >= 1) return false;
    *w = normalize(along(scale(-1 / eta, known), known_s / eta - copysign(cos_t, known_s), s->ns));
    return side(*w, s, &w_s) * known_g < 0;
}

static Vec3 mirrored_change(const Surface *s, Vec3 known, Vec3 d_known, Vec3 d_ns)
{
    double change = dot(d_known, s->ns) + dot(known, d_ns);
    return add(neg(d_known), scale(2, along(scale(change, s->ns), dot(known, s->ns), d_ns)));
}

static Vec3 refracted_change(const Surface *s, Vec3 known, Vec3 d_known, Vec3 d_ns)
{
    double known_s = dot(known, s->ns), change = dot(d_known, s->ns) + dot(known, d_ns), cos_t, eta = relative_index(s->material, known_s);
    bsdf_fresnel(fabs(known_s), eta, &cos_t);
    double along_ns = known_s / eta - copysign(cos_t, known_s), change_along = change * (1 / eta - fabs(known_s) / (eta * eta * cos_t));
    return along(along(scale(-1 / eta, d_known), change_along, s->ns), along_ns, d_ns);
}

/* The least rotation from unit a to unit b, of w:  w - w.(a+b)/(1+a.b) (a+b) + 2 w.a b,  which is nothing for a = -b. */
bool bsdf_pass(const Surface *s, Vec3 known, const Passage *passage, Vec3 *w)
{
    if (passage->mode != MODE_NONE) return bsdf_follow(s, known, passage->mode, w);
    if (!material_is_narrow(s->material)) return false;
    Vec3 b = bsdf_mirrored(s, known), sum = add(passage->mirrored, b);
    double c = 1 + dot(passage->mirrored, b);
    if (!(c > 1e-6)) return false;
    *w = normalize(along(along(passage->w, -dot(passage->w, sum) / c, sum), 2 * dot(passage->w, passage->mirrored), b));
    return true;
}

Vec3 bsdf_pass_change(const Surface *s, Vec3 known, const Passage *passage, Vec3 d_known, Vec3 d_ns)
{
    if (passage->mode == MODE_REFRACT) return refracted_change(s, known, d_known, d_ns);
    Vec3 a = passage->mirrored, w = passage->w, b = bsdf_mirrored(s, known), d_b = mirrored_change(s, known, d_known, d_ns), sum = add(a, b);
    if (passage->mode == MODE_REFLECT) return d_b;
    double c = 1 + dot(a, b), along_sum = dot(w, sum) / c, d_along_sum = (dot(w, d_b) - along_sum * dot(a, d_b)) / c;
    return along(along(scale(-d_along_sum, sum), -along_sum, d_b), 2 * dot(w, a), d_b);
}

static bool sample_specular(const Surface *s, Vec3 known, Rng *rng, Vec3 *w, Mode *mode)
{
    double known_s, cos_t;
    if (side(known, s, &known_s) == 0) return false;
    *mode = MODE_REFLECT;
    if (s->material->kind == MATERIAL_GLASS && rng_double(rng) >= bsdf_fresnel(fabs(known_s), relative_index(s->material, known_s), &cos_t))
        *mode = MODE_REFRACT;
    return bsdf_follow(s, known, *mode, w);
}

/* The squared distance of a point of the disk from its middle is as uniform as any number: the cosine comes of it, and the azimuth of the rest. */
bool bsdf_sample_at(const Surface *s, Vec3 known, const double disk[2], Rng *rng, Vec3 *w, Mode *mode)
{
    if (material_is_specular(s->material)) return sample_specular(s, known, rng, w, mode);
    double known_s, w_s, known_g = side(known, s, &known_s), d = diffuse_prob(s);
    *mode = MODE_NONE;
    if (known_g == 0) return false;
    if (d == 1 || rng_double(rng) < d) *w = lift(known_s > 0 ? s->ns : neg(s->ns), disk[0], disk[1]);
    else {
        double squared = disk[0] * disk[0] + disk[1] * disk[1], c = pow(1 - squared, 1 / (s->material->ns + 1));
        *w = turned(bsdf_mirrored(s, known), c, sqrt(1 - c * c), disk[0], disk[1], squared);
    }
    return side(*w, s, &w_s) * known_g > 0;
}

bool bsdf_sample(const Surface *s, Vec3 known, Rng *rng, Vec3 *w, Mode *mode)
{
    if (material_is_specular(s->material)) return sample_specular(s, known, rng, w, mode);
    double disk[2];
    do rng_disk(rng, &disk[0], &disk[1]);
    while (disk[0] == 0 && disk[1] == 0);
    return bsdf_sample_at(s, known, disk, rng, w, mode);
}

double bsdf_albedo(const Surface *s)
{
    const Material *m = s->material;
    if (m->kind == MATERIAL_MIRROR) return max3(m->ks);
    if (m->kind == MATERIAL_GLASS) return 1;
    return smaller(1, max3(add(s->kd, m->ks)));
}
