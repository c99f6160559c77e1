/* One mutation with all of its numbers, and an audit. See explain.h.
 *
 *   names     x_i, z_0 .. for what is new in y, and F(a,b,c) G(a,b) C(a,b,c,d) S>(a,b,c) S<(a,b,c) as in path.h; a dot stands where a path has ended
 *   one half  R(y|x) or R(x|y) of a bidirectional mutation                                  [lecture: Probabilities; Finding T(y|x)]
 *   examples  the same in the slides' own forms, their slips corrected                      [lecture: Example I fleshed out; Example 2]
 *   the rest  R of the other mutations, the search for a mutation, and the audit
 */
#include "explain.h"
#include <inttypes.h>
#include <stdlib.h>
#include <string.h>

enum { BIDIR, LENS, CAUSTIC, CHAIN, SUBPATH };                /* rows of mutation_table */
enum { CHAINS = 400, CHAIN_STEPS = 1000, TEXT = 96 };
static const uint64_t default_count = 20000, audit_count = 50000;

/* ---- names and values ---- */

/* A path whose vertices first .. first+count-1 are new (z_0 ..); those beyond have the names that they have in x, 'shift' below. */
typedef struct { const Path *path; int first, count, shift; } Named;

static const char *vertex_name(const Named *n, int i, char text[16])
{
    if (i < 0 || i > n->path->k) strcpy(text, ".");
    else if (i < n->first) snprintf(text, 16, "x_%d", i);
    else if (i < n->first + n->count) snprintf(text, 16, "z_%d", i - n->first);
    else snprintf(text, 16, "x_%d", i - n->shift);
    return text;
}

/* What products are made of. COPIED: S at a vertex whose mode was copied, so that q counts as 1 and S = F and not F/F. TURNED: a direction
 * whose density per solid angle depends on the angle alone: what is left of F/p is F |cos|. */
typedef enum { F_, G_, C_, S_LENS, S_LIGHT, P_LENS, P_LIGHT, COPIED_LENS, COPIED_LIGHT, TURNED_LENS, TURNED_LIGHT } Kind;
static const struct { const char *name; int from, to; } kind_table[] = {
    { "F", -1, 1 }, { "G", 0, 1 }, { "C", -1, 2 }, { "S>", -1, 1 }, { "S<", -1, 1 }, { "p>", -1, 1 }, { "p<", -1, 1 },
    { "q S>", -1, 1 }, { "q S<", -1, 1 }, { "F|cos>|", -1, 1 }, { "F|cos<|", -1, 1 },
};
typedef struct { Kind kind; int i; } Factor;
typedef struct { int n; Factor factor[3 * MAX_EDGES + 8]; } Product;

static void times(Product *p, Kind kind, int i) { p->factor[p->n++] = (Factor){ kind, i }; }

/* The scalar scattering, at a specular vertex reflectance times (eta_lens/eta_light)^2: S< = F/q there. */
static double value_F(const Path *p, int i)
{
    const Scatter *s = &p->v[i].s;
    return path_specular(p, i) ? s->q / s->inv_S_light : 1 / s->inv_F;
}

/* NAN where there is no such thing */
static double value(const Path *p, Factor f)
{
    int i = f.i;
    bool scatters = i > 0 && i < p->k;
    const Vertex *v = &p->v[i < 0 ? 0 : i > p->k ? p->k : i];
    double inverse = NAN;
    switch (f.kind) {
    case F_: return i >= 0 && i <= p->k ? value_F(p, i) : NAN;
    case G_: return i >= 0 && i < p->k ? 1 / v->inv_G : NAN;
    case C_: inverse = path_inv_C(p, i); break;
    case S_LENS: inverse = i < p->k ? path_inv_S_lens(p, i) : 0; break;
    case S_LIGHT: inverse = i > 0 ? path_inv_S_light(p, i) : 0; break;
    case P_LENS: return i < p->k ? path_inv_S_lens(p, i) * (i < 0 ? 1 : value_F(p, i)) : NAN;
    case P_LIGHT: return i > 0 ? path_inv_S_light(p, i) * (i > p->k ? 1 : value_F(p, i)) : NAN;
    case COPIED_LENS: inverse = v->s.inv_S_lens / v->s.q; break;
    case COPIED_LIGHT: inverse = v->s.inv_S_light / v->s.q; break;
    case TURNED_LENS: inverse = v->s.inv_F / fabs(dot(v->to_lens, v->point.surface.ng)); break;
    case TURNED_LIGHT: if (scatters) inverse = v->s.inv_F / fabs(dot(v[-1].to_lens, v->point.surface.ng)); break;
    }
    return inverse > 0 ? 1 / inverse : NAN;
}

static double product(const Path *path, const Product *p)
{
    double all = 1;
    for (int i = 0; i < p->n; i++) all *= value(path, p->factor[i]);
    return all;
}

static const char *factor_name(const Named *n, Factor f, char text[TEXT])
{
    char name[16];
    int at = snprintf(text, TEXT, "%s(", kind_table[f.kind].name);
    for (int i = kind_table[f.kind].from; i <= kind_table[f.kind].to; i++)
        at += snprintf(text + at, (size_t)(TEXT - at), "%s%s", vertex_name(n, f.i + i, name), i < kind_table[f.kind].to ? "," : ")");
    return text;
}

/* The names side by side, or the numbers with a star between. */
static void print_product(FILE *out, const Named *n, const Product *p, bool numbers)
{
    char text[TEXT];
    for (int i = 0; i < p->n; i++) {
        if (numbers) fprintf(out, "%s%.9g", i ? " * " : "", value(n->path, p->factor[i]));
        else fprintf(out, "%s%s", i ? " " : "", factor_name(n, p->factor[i], text));
    }
    if (p->n == 0) fputs("1", out);
}

/* ---- paths ---- */

static const char *vertex_kind(const Path *p, int i)
{
    if (i == 0) return "light";
    if (i == p->k) return "lens";
    const Material *m = p->v[i].point.surface.material;
    if (m->kind == MATERIAL_MIRROR) return "mirror";
    if (m->kind == MATERIAL_GLASS) return p->v[i].mode == MODE_REFLECT ? "glass, reflects" : "glass, refracts";
    return max3(m->ks) > 0 ? "glossy" : "diffuse";
}

static void print_path(FILE *out, const char *name, const Space *space, const Named *n)
{
    const Path *p = n->path;
    const Mesh *mesh = &space->scene->mesh;
    char text[16];
    fprintf(out, "\n%s =", name);
    for (int i = 0; i <= p->k; i++) fprintf(out, " %s", vertex_name(n, i, text));
    fprintf(out, "    k = %d edges, from the light to the lens; seen at (%.2f, %.2f) on the film\n", p->k, p->raster_x, p->raster_y);
    for (int i = 0; i <= p->k; i++) {
        Vec3 at = along(mesh->centre, mesh->unit, p->v[i].point.p);
        const Material *m = p->v[i].point.surface.material;
        fprintf(out, "  %-6s %-16s (%10.5g, %10.5g, %10.5g)  %s\n", vertex_name(n, i, text), vertex_kind(p, i), at.x, at.y, at.z, m && m->name ? m->name : "");
    }
}

/* The cached numbers of v[from] .. v[to]. */
static void print_numbers_along(FILE *out, const Named *n, int from, int to)
{
    static const Kind column[] = { F_, S_LENS, S_LIGHT, G_, C_ };
    const Path *p = n->path;
    char text[16];
    fprintf(out, "  %-6s %14s %14s %14s %14s %14s %14s\n", "", "F", "S> = F/p>", "S< = F/p<", "G to the next", "C with it", "q of the mode");
    for (int i = from; i <= to; i++) {
        fprintf(out, "  %-6s", i == -1 ? "(-1)" : i > p->k ? "(k+1)" : vertex_name(n, i, text));
        for (int c = 0; c < 5; c++) {
            double number = value(p, (Factor){ column[c], i });
            if (isnan(number)) fprintf(out, " %14s", "-");
            else fprintf(out, " %14.9g", number);
        }
        if (path_specular(p, i)) fprintf(out, " %14.9g", p->v[i].s.q);
        fputc('\n', out);
    }
}

/* ---- the bidirectional mutation ---- */

/* One half of a mutation: 'from' loses its segment s .. t, 'to' has s .. t_to in its place. The numbers are the move's. */
typedef struct {
    const Named *from, *to;
    const char *x, *y;                         /* their names */
    int s, t, t_to, taken;                     /* taken: the way j by which it came; -1 for the way back */
    double p_d1, p_d2, p_a1, p_a2, routes, R;
} Half;

/* Q_j of the path 'to': f over the density of way j, in which every G but that of the joined edge cancels. */
static Product way(int s, int t, int j)
{
    Product p = { .n = 0 };
    int e = s + j;
    for (int i = s; i < e; i++) times(&p, S_LENS, i);
    times(&p, C_, e);
    for (int i = e + 2; i <= t; i++) times(&p, S_LIGHT, i);
    return p;
}

/* Why way j adds nothing to T; false if it does. *possible: whether it is ever tried. */
static bool no_way(const Half *h, int j, bool *possible, char text[TEXT])
{
    const Path *z = h->to->path;
    char name[16];
    int m = h->t_to - h->s - 1, e = h->s + j;
    bool specular_s = path_specular(z, h->s), specular_t = path_specular(z, h->t_to);
    *possible = !((j == 0 && specular_s) || (j == m && (specular_t || h->t_to > z->k)));
    if (j == m && h->t_to > z->k) snprintf(text, TEXT, "a new lens point comes from the lens side");
    else if (path_specular(z, e)) snprintf(text, TEXT, "%s is specular and cannot be joined", vertex_name(h->to, e, name));
    else if (path_specular(z, e + 1)) snprintf(text, TEXT, "%s is specular and cannot be joined", vertex_name(h->to, e + 1, name));
    else if (isnan(product(z, (Product[]){ way(h->s, h->t_to, j) }))) snprintf(text, TEXT, "no sample goes this way: a density is 0");
    else return false;
    return true;
}

static double raw_p_d1(int k_d) { return k_d == 1 ? 0.25 : k_d == 2 ? 0.5 : ldexp(1, -k_d); }
static double raw_p_a1(int d) { return d == 0 ? 0.5 : abs(d) == 1 ? 0.15 : 0.1 * ldexp(1, 1 - abs(d)); }

static void print_deletion(FILE *out, const Half *h, const Tuning *tuning)
{
    const Path *p = h->from->path;
    int k_d = h->t - h->s, n = p->k + 3 - k_d;
    double share = tuning->p_d2_importance, W = 0, mine = 0;
    fprintf(out, "  delete: s = %d, t = %d, k_d = t - s = %d of %d edges [lecture: Choosing a segment to delete; Deletion Probability]\n", h->s, h->t, k_d, p->k);
    fprintf(out, "    p_d1^%s[%d] = %.9g / (1 - %.9g) = %.9g    1/4, 1/2, 2^-e; cut at k + 2 and normalised again\n", h->x, k_d, raw_p_d1(k_d), ldexp(1, -(p->k + 2)), h->p_d1);
    fprintf(out, "    w^%s[s,t], the computable part of 1/R(%s|%s), for each segment of %d edge%s%s:\n     ", h->x, h->x, h->y, k_d, k_d > 1 ? "s" : "",
            tuning->light_scale != 1 ? " (with s = -1 times light_scale)" : "");
    for (int s = -1; s <= p->k + 1 - k_d; s++) {
        double w = bidir_w(p, s, s + k_d) * (s < 0 ? tuning->light_scale : 1);
        W += w;
        if (s == h->s) mine = w;
        fprintf(out, " w^%s[%d,%d] = %.9g%s", h->x, s, s + k_d, w, s == p->k + 1 - k_d ? "\n" : ";");
    }
    fprintf(out, "    W^%s(%d) = sum of these = %.9g\n", h->x, k_d, W);
    fprintf(out, "    p_d2^%s[%d,%d] = share uniform over %d segments, the rest w/W = %.9g / %d + %.9g * %.9g / %.9g = %.9g\n", h->x, h->s, h->t, n, 1 - share, n, share, mine, W, h->p_d2);
    fprintf(out, "    p_d^%s[%d,%d] = p_d1 p_d2 = %.9g * %.9g = %.9g\n", h->x, h->s, h->t, h->p_d1, h->p_d2, h->p_d1 * h->p_d2);
}

static void print_half(FILE *out, const Half *h, const Tuning *tuning)
{
    const Path *z = h->to->path;
    int k_d = h->t - h->s, k_a = h->t_to - h->s, m = k_a - 1, ways = (int)lround(1 / h->p_a2);
    double p_a = h->p_a1 * h->p_a2;
    char text[TEXT];
    bool possible, first = true;
    print_deletion(out, h, tuning);
    fprintf(out, "  add: k_a = %d edge%s, so m = s' + t' = %d new vert%s [lecture: Choosing a segment to add]\n", k_a, k_a > 1 ? "s" : "", m, m == 1 ? "ex" : "ices");
    fprintf(out, "    p_a1^%s[%d] = %.9g / %.9g = %.9g    1/2, 0.15, 0.15, rest; cut and normalised again\n", h->x, k_a, raw_p_a1(k_a - k_d), raw_p_a1(k_a - k_d) / h->p_a1, h->p_a1);
    fprintf(out, "    p_a^%s[s',t'] = p_a1 / %d possible = %.9g / %d = %.9g\n", h->x, ways, h->p_a1, ways, p_a);
    fprintf(out, "  what the ways are made of, along %s:\n", h->y);
    print_numbers_along(out, h->to, h->s, h->t_to);
    fprintf(out, "  the ways [s',t'] to make %s from %s, Q = f over density [lecture: T(y|x) must take all possible routes into account]\n", h->y, h->x);
    for (int j = 0; j <= m; j++) {
        if (no_way(h, j, &possible, text)) {
            fprintf(out, "    [%d,%d]  p_a/Q^%s = 0: %s%s\n", j, m - j, h->x, text, possible ? "" : ", so p_a = 0");
            continue;
        }
        Product q = way(h->s, h->t_to, j);
        fprintf(out, "    Q^%s[%d,%d] = ", h->x, j, m - j);
        print_product(out, h->to, &q, false);
        fputs(" = ", out);
        print_product(out, h->to, &q, true);
        fprintf(out, " = %.9g%s\n", product(z, &q), j == h->taken ? "    <- taken" : "");
        fprintf(out, "      p_a/Q^%s[%d,%d] = %.9g / %.9g = %.9g\n", h->x, j, m - j, p_a, product(z, &q), p_a / product(z, &q));
    }
    fprintf(out, "  sum^%s = ", h->x);
    for (int j = 0; j <= m; j++) {
        if (no_way(h, j, &possible, text)) continue;
        fprintf(out, "%s%.9g", first ? "" : " + ", p_a / product(z, (Product[]){ way(h->s, h->t_to, j) }));
        first = false;
    }
    fprintf(out, " = %.9g\n  chi(%s) = %.9g    colours apart: w(pixel) luminance(product of f_s^rgb / F)\n", p_a * h->routes, h->y, z->chi);
    fprintf(out, "  R(%s|%s) = f(%s)/T(%s|%s) = chi(%s) / ( p_d^%s[%d,%d] sum^%s ) = %.9g / (%.9g * %.9g) = %.9g\n", h->y, h->x, h->y, h->y, h->x, h->y,
            h->x, h->s, h->t, h->x, z->chi, h->p_d1 * h->p_d2, p_a * h->routes, h->R);
}

/* ---- the lecture's two examples ---- */

/* R as f/T with nothing cancelled but the factors that x and y share: f_s and G above, p_d, p_a, p_s and G below. */
static void print_plain(FILE *out, const Half *h)
{
    const Path *z = h->to->path;
    int m = h->t_to - h->s - 1;
    double K = h->p_d1 * h->p_d2, p_a = h->p_a1 * h->p_a2;
    Product f = { .n = 0 };
    for (int i = h->s; i <= h->t_to; i++) {
        times(&f, F_, i);
        if (i < h->t_to) times(&f, G_, i);
    }
    for (int numbers = 0; numbers <= 1; numbers++) {
        if (numbers) fprintf(out, "      = %.9g * ", z->chi);
        else fprintf(out, "    R(%s|%s) = chi(%s) ", h->y, h->x, h->y);
        print_product(out, h->to, &f, numbers);
        if (numbers) fprintf(out, " / (%.9g * (", K);
        else fprintf(out, " / ( p_d^%s[%d,%d] ( ", h->x, h->s, h->t);
        for (int j = 0; j <= m; j++) {
            Product p = { .n = 0 };
            for (int i = h->s; i < h->s + j; i++) times(&p, P_LENS, i), times(&p, G_, i);
            for (int i = h->t_to; i > h->s + j + 1; i--) times(&p, P_LIGHT, i), times(&p, G_, i - 1);
            if (numbers) fprintf(out, "%s%.9g * ", j ? " + " : "", p_a);
            else fprintf(out, "%sp_a^%s[%d,%d] ", j ? " + " : "", h->x, j, m - j);
            print_product(out, h->to, &p, numbers);
        }
        if (numbers) fprintf(out, ")) = %.9g\n", h->R);
        else fputs(" ) )\n", out);
    }
}

/* The slides' chain of equations for one vertex against none. */
static void print_one_vertex(FILE *out, const Half *h)
{
    const Path *z = h->to->path;
    int s = h->s;
    double chi = z->chi, K = h->p_d1 * h->p_d2, A = h->p_a1 * h->p_a2, f1 = value_F(z, s), f2 = value_F(z, s + 1), f3 = value_F(z, s + 2);
    double G1 = 1 / z->v[s].inv_G, G2 = 1 / z->v[s + 1].inv_G, C1 = 1 / path_inv_C(z, s), C2 = 1 / path_inv_C(z, s + 1);
    double S1 = 1 / path_inv_S_lens(z, s), S2 = 1 / path_inv_S_light(z, s + 2);
    char f[3][TEXT], C[2][TEXT], G[2][TEXT], S[2][TEXT];
    for (int i = 0; i < 3; i++) factor_name(h->to, (Factor){ F_, s + i }, f[i]);
    for (int i = 0; i < 2; i++) factor_name(h->to, (Factor){ C_, s + i }, C[i]), factor_name(h->to, (Factor){ G_, s + i }, G[i]);
    factor_name(h->to, (Factor){ S_LENS, s }, S[0]);
    factor_name(h->to, (Factor){ S_LIGHT, s + 2 }, S[1]);
    fprintf(out, "    with K = p_d^%s[%d,%d] = %.9g, A = p_a^%s[1,0] = %.9g, B = p_a^%s[0,1] = %.9g\n", h->x, s, h->t, K, h->x, A, h->x, A);
    fprintf(out, "    with C = %s = %.9g, C' = %s = %.9g, S = %s = %.9g, S' = %s = %.9g\n", C[0], C1, C[1], C2, S[0], S1, S[1], S2);
    fprintf(out, "    R(%s|%s) = chi (C C' / %s) / ( K ( A %s %s / S + B %s %s / S' ) )\n", h->y, h->x, f[1], f[0], G[0], f[2], G[1]);
    fprintf(out, "      = %.9g * (%.9g * %.9g / %.9g) / (%.9g * (%.9g * %.9g * %.9g / %.9g + %.9g * %.9g * %.9g / %.9g)) = %.9g\n", chi, C1, C2, f2, K, A, f1, G1, S1, A, f3, G2, S2, h->R);
    fprintf(out, "    R(%s|%s) = chi (C C' / %s) / ( K ( A C / S + B C' / S' ) / %s )\n", h->y, h->x, f[1], f[1]);
    fprintf(out, "      = %.9g * (%.9g * %.9g / %.9g) / (%.9g * (%.9g * %.9g / %.9g + %.9g * %.9g / %.9g) / %.9g) = %.9g\n", chi, C1, C2, f2, K, A, C1, S1, A, C2, S2, f2, h->R);
    fprintf(out, "    R(%s|%s) = chi C C' / ( K ( A C / S + B C' / S' ) )\n", h->y, h->x);
    fprintf(out, "      = %.9g * %.9g * %.9g / (%.9g * (%.9g * %.9g / %.9g + %.9g * %.9g / %.9g)) = %.9g\n", chi, C1, C2, K, A, C1, S1, A, C2, S2, h->R);
}

static void print_example(FILE *out, int example, const Half *there, const Half *back)
{
    fprintf(out, "\nEXAMPLE %d as the slides write it    F stands for f_s, chi for colour; factors that f(x) and f(y) share are dropped\n  there:\n", example);
    print_plain(out, there);
    if (example == 1) print_one_vertex(out, there);
    fputs("  and back:\n", out);
    print_plain(out, back);
    if (example == 2) print_one_vertex(out, back);
    if (example == 1)
        fputs("  where this differs from the slides:\n"
              "    'prob. of sampling z_0 is p_s(x_0,x_1,z_0) G(x_0,x_1)': the G is that of the sampled edge, G(x_1,z_0)\n"
              "    S(x_3,x_2,z_0) and C(x_3,x_2,z_0,x_1), arguments reversed, take f_s for symmetric: read F(z_0,x_2,x_3)/p<, and C' = C(x_1,z_0,x_2,x_3)\n"
              "    'Addition probability: 1/2' is that of equal lengths: in edges 2 replace 1, so p_a1 is 0.15 (normalised), shared by two ways\n"
              "    p_d holds the missing p_d2; and a lacks min(1, .)\n", out);
    else fputs("  the slides stop at 'numerator is ...': it stands above, before the first '/'; z_0, z_1 come by the ways [2,0], [1,1], [0,2]\n", out);
}

/* ---- the other mutations ---- */

/* R of a path whose vertices from m on were moved (caustic: beyond m). */
static Product perturbation_R(int row, const Path *p, int m)
{
    Product r = { .n = 0 };
    if (row == CAUSTIC) {
        times(&r, TURNED_LENS, m);
        for (int i = m + 1; i < p->k - 1; i++) times(&r, COPIED_LENS, i);
        times(&r, C_, p->k - 1);
        return r;
    }
    times(&r, C_, m - 1);
    for (int i = m + 1; i < p->k; i++) times(&r, row == SUBPATH ? S_LIGHT : path_specular(p, i) ? COPIED_LIGHT : TURNED_LIGHT, i);
    return r;
}

static double angle(Vec3 a, Vec3 b) { return atan2(length(cross(a, b)), dot(a, b)); }

static void print_R(FILE *out, int row, const Named *n, const char *y, const char *x, int m, double R)
{
    Product p = perturbation_R(row, n->path, m);
    fprintf(out, "  along %s:\n", y);
    print_numbers_along(out, n, m > 0 ? m - 1 : row == CAUSTIC ? 0 : -1, n->path->k);
    fprintf(out, "  chi(%s) = %.9g    colours apart: w(pixel) luminance(product of f_s^rgb / F)\n  R(%s|%s) = chi(%s) ", y, n->path->chi, y, x, y);
    print_product(out, n, &p, false);
    fprintf(out, " = %.9g * ", n->path->chi);
    print_product(out, n, &p, true);
    fprintf(out, " = %.9g\n", R);
}

static void print_perturbation(FILE *out, int row, const Tuning *t, const Named *x, const Named *y, const Move *move)
{
    const Path *a = x->path, *b = y->path;
    int m = row == CAUSTIC ? move->first - 1 : move->first;
    char name[16];
    fprintf(out, "\nMOVE  x_%d .. x_%d are replaced [lecture: 'two other mutation strategies']\n", move->first, move->last);
    if (row == CAUSTIC)
        fprintf(out, "  the direction from x_%d towards the lens is turned by %.6g radians, of steps from %.6g to %.6g\n", m, angle(a->v[m].to_lens, b->v[m].to_lens),
                t->theta2 * exp(t->log_theta), t->theta2);
    else if (row == SUBPATH) fprintf(out, "  a fresh raster position, uniform over the film%s: from (%.4f, %.4f) to (%.4f, %.4f)\n",
                                   y->first + y->count > b->k ? ", and a fresh point of the lens" : "", a->raster_x, a->raster_y, b->raster_x, b->raster_y);
    else
        fprintf(out, "  the raster position moves by %.6g pixels, of steps from %.6g to %.6g: from (%.4f, %.4f) to (%.4f, %.4f)\n",
                hypot(b->raster_x - a->raster_x, b->raster_y - a->raster_y), t->r2 * exp(t->log_r), t->r2, a->raster_x, a->raster_y, b->raster_x, b->raster_y);
    for (int i = b->k - 1; i > m && row != CAUSTIC && row != SUBPATH; i--)
        if (!path_specular(b, i))
            fprintf(out, "  at %s the old direction towards the light is turned by %.6g radians, of steps from %.6g to %.6g\n", vertex_name(y, i, name),
                    angle(a->v[i - 1].to_lens, b->v[i - 1].to_lens), t->theta2 * exp(t->log_theta), t->theta2);
    fputs(row == SUBPATH ? "  The modes are drawn: S = F/q stays a ratio. What both directions share, the density over the film, cancels.\n"
                         : "  Modes are copied, not drawn: q counts as 1, and q S = F stands where S = F/F would. A turned direction leaves F |cos|. Steps are as likely\n"
                           "  there as back, so their density cancels.\n", out);
    fputs("\nTHERE\n", out);
    print_R(out, row, y, "y", "x", m, move->R_yx);
    fputs("\nAND BACK\n", out);
    print_R(out, row, x, "x", "y", m, move->R_xy);
}

/* ---- a step of the chain ---- */

typedef struct {
    Path x, y, before, after, fresh_x, fresh_y;
    Bdpt *bdpt;
    Bootstrap seeds;
} Lab;

typedef struct {
    int row;                                   /* -1: no row applied */
    Outcome outcome;
    bool accepted;
    double a;
    Move move;
} Step;

/* With steps of one the weights are a and 1 - a, in either order. */
typedef struct { int n; double weight[2]; } Weights;
static void keep_weight(void *context, const Path *path, double weight)
{
    Weights *w = context;
    (void)path;
    if (w->n < 2) w->weight[w->n++] = weight;
}

/* The chain makes one step from lab->x; 'before' and 'after' hold what it went from and proposed. The proposal is replayed with the random
 * numbers that the chain used: the first one chose the row. */
static Step make_step(Lab *lab, const Space *space, const Sampler *sampler, Rng *rng)
{
    Step step = { .row = -1 };
    Weights weights = { .n = 0 };
    ChainCount count = { .steps = 0 };
    Rng replay = *rng;
    path_copy(&lab->before, &lab->x);
    chain_run(space, sampler, &lab->x, &lab->y, 1, rng, keep_weight, &weights, &count);
    for (int r = 0; r < sampler->rows; r++)
        if (count.row[r].proposed) step.row = r;
    if (step.row < 0) return step;
    rng_double(&replay);
    sampler->table[step.row].propose(space, &sampler->tuning, &lab->before, &lab->after, &replay, &step.move);
    for (int i = 0; i < OUTCOMES; i++)
        if (count.row[step.row].outcome[i]) step.outcome = (Outcome)i;
    step.accepted = count.row[step.row].accepted > 0;
    step.a = step.outcome != PROPOSED ? 0 : step.accepted ? weights.weight[weights.n - 1] : weights.n > 1 ? weights.weight[0] : 0;
    return step;
}

static bool wanted(const ExplainOptions *o, const Sampler *sampler, const Path *x, const Step *step)
{
    const Move *m = &step->move;
    if (step->row < 0 || (step->outcome != PROPOSED && step->outcome != ZERO_BLOCKED)) return false;
    if ((o->accepted && !step->accepted) || (o->length && x->k != o->length) || (o->strategy && strcmp(sampler->table[step->row].name, o->strategy) != 0)) return false;
    if (step->row == BIDIR && m->k_d == 1 && m->k_a == 1) return false;    /* y = x */
    bool specular = !sampler->table[step->row].needs_specular;             /* such a row is best seen at a path that needs it */
    for (int i = m->first; i <= m->last; i++) specular |= path_specular(x, i);
    if (!o->example) return specular;
    /* k = 3: s = 1, t = 2, s' = 1, t' = 0.   k = 4: s = 1, t = 3, s' = 1, t' = 1 */
    return step->row == BIDIR && step->outcome == PROPOSED && m->s == 1 && m->j == 1
        && (o->example == 1 ? x->k == 3 && m->t == 2 && m->k_a == 2 : x->k == 4 && m->t == 3 && m->k_a == 3);
}

/* q_i(x), the probability of the row among those that apply, with the shares it is made of. */
static double print_choice(FILE *out, const Space *space, const Sampler *s, const Path *x, const char *name, int row)
{
    double sum = 0;
    bool first = true;
    fprintf(out, "  q(%s) = share of '%s' among the rows that apply = %.9g / (", name, s->table[row].name, s->share[row]);
    for (int r = 0; r < s->rows; r++) {
        if (!(s->share[r] > 0) || !s->table[r].applies(space, x)) continue;
        fprintf(out, "%s%.9g", first ? "" : " + ", s->share[r]);
        sum += s->share[r];
        first = false;
    }
    double q = s->table[row].applies(space, x) ? s->share[row] / sum : 0;
    fprintf(out, ") = %.9g    of", q);
    for (int r = 0; r < s->rows; r++)
        if (s->share[r] > 0 && s->table[r].applies(space, x)) fprintf(out, " %s", s->table[r].name);
    fputc('\n', out);
    return q;
}

static void print_step(FILE *out, const Space *space, const Sampler *sampler, const Lab *lab, const Step *step, int example)
{
    const Path *x = &lab->before, *y = &lab->after;
    const Move *m = &step->move;
    const double unit = space->scene->mesh.unit;
    bool bidir = step->row == BIDIR, lens_moved = step->row == SUBPATH && space->scene->camera.aperture > 0;
    int first = bidir ? m->s + 1 : m->first, gone = bidir ? m->k_d - 1 : m->last - m->first + 1 + lens_moved;
    Named old = { x, x->k + 1, 0, 0 }, new = { y, first, gone + y->k - x->k, y->k - x->k };
    char a[16], b[16];
    fprintf(out, "A mutation by '%s'. Points are in the scene's own unit; G, C and densities per area count in the program's, which is %.9g of those.\n",
            sampler->table[step->row].name, unit);
    print_path(out, "x", space, &old);
    print_path(out, "y", space, &new);
    if (bidir) {
        int t_new = m->s + m->k_a;
        Half there = { &old, &new, "x", "y", m->s, m->t, t_new, m->j, m->p_d1_x, m->p_d2_x, m->p_a1_x, m->p_a2_x, m->routes_y, m->R_yx };
        Half back = { &new, &old, "y", "x", m->s, t_new, m->t, -1, m->p_d1_y, m->p_d2_y, m->p_a1_y, m->p_a2_y, m->routes_x, m->R_xy };
        fprintf(out, "\nTHERE  from x to y: s' = %d, t' = %d\n", m->j, m->k_a - 1 - m->j);
        print_half(out, &there, &sampler->tuning);
        fputs("\nAND BACK  from y to x\n", out);
        print_half(out, &back, &sampler->tuning);
        if (example) print_example(out, example, &there, &back);
    } else print_perturbation(out, step->row, &sampler->tuning, &old, &new, m);
    fputs("\nACCEPTANCE [lecture: AcceptProb, with min(1, .) and the choice of the strategy]\n", out);
    double q_x = print_choice(out, space, sampler, x, "x", step->row), q_y = print_choice(out, space, sampler, y, "y", step->row);
    int V = step->outcome != ZERO_BLOCKED;
    if (m->joined >= 0) fprintf(out, "  V(%s,%s) = %d    %s\n", vertex_name(&new, m->joined, a), vertex_name(&new, m->joined + 1, b), V, V ? "nothing is in between" : "blocked, f(y) = 0");
    else fputs("  V = 1    no edge was joined: all were traced\n", out);
    fprintf(out, "  a(y|x) = V min(1, R(y|x) q(y) / ( R(x|y) q(x) )) = %d * min(1, %.9g * %.9g / (%.9g * %.9g)) = %.9g\n", V, m->R_yx, q_y, m->R_xy, q_x, step->a);
    fprintf(out, "  The chain %s y.\n", step->accepted ? "accepted" : "rejected");
}

static bool explain_one(Lab *lab, const Space *space, const Sampler *sampler, const ExplainOptions *o, FILE *out, Report *report)
{
    for (int chain = 0; chain < CHAINS; chain++) {
        Rng rng = rng_new(o->seed, ((uint64_t)1 << 40) + (uint64_t)chain);
        if (!bootstrap_seed(&lab->seeds, space, lab->bdpt, rng_double(&rng), &lab->x)) continue;
        for (int i = 0; i < CHAIN_STEPS; i++) {
            Step step = make_step(lab, space, sampler, &rng);
            if (!wanted(o, sampler, &lab->before, &step)) continue;
            print_step(out, space, sampler, lab, &step, o->example);
            return true;
        }
    }
    return report_error(report, NULL, 0, "no such mutation among %d proposals: ask for less, or try another --seed", CHAINS * CHAIN_STEPS);
}

/* ---- the audit: is R = f/T? ---- */

enum { STATES = 8, AGAIN = 50, U_BINS = 6, PHI_BINS = 6, BINS = U_BINS * PHI_BINS + 1, K_BINS = 6, S_BINS = 16, J_BINS = 8, FAMILY = 2048, FAMILIES = 3,
       ENOUGH = 100, OCTAVE_BINS = 800, FLOW_STEPS = 16, KEEP = 30, ALL = 4096 };
static const double false_alarm = 1e-6, worst_allowed = 1e-6;    /* of the whole audit; relative difference of R */
typedef long double Real;

/* p of the direction that was drawn at z_i, per projected solid angle: the probability of its mode at a specular vertex, where f has the same delta;
 * 1 for a copied mode; per area at a light point, 1 at a lens point. */
static Real pdf_to_lens(const Path *z, int i, bool copied)
{
    if (i < 0) return z->light_pdf_a;
    return (Real)value_F(z, i) * z->v[i].s.inv_S_lens / (copied ? z->v[i].s.q : 1);
}
static Real pdf_to_light(const Path *z, int i, bool copied)
{
    if (i > z->k) return 1;
    return (Real)value_F(z, i) * z->v[i].s.inv_S_light / (copied ? z->v[i].s.q : 1);
}

/* F_s G_s .. F_t: the factors of f between two vertices, as far as there are any */
static Real f_between(const Path *z, int s, int t)
{
    Real f = 1;
    for (int i = s < 0 ? 0 : s; i <= t && i <= z->k; i++) f *= value_F(z, i) * (i < t && i < z->k ? 1 / (Real)z->v[i].inv_G : 1);
    return f;
}

/* sum over ways j of p_a2[j] * density per area of the vertices between z_s and z_t: one ray after the other, every G written out */
static Real density_of_ways(const Path *z, int s, int t)
{
    int m = t - s - 1, ways = 0;
    bool light = s < 0 && m == 0, specular_s = path_specular(z, s), specular_t = path_specular(z, t);
    Real sum = 0;
    if (s >= z->k || (light && (t >= z->k || !material_emits(z->v[0].point.surface.material)))) return 0;
    for (int j = 0; j <= m; j++) {
        int e = s + j;
        if (!light && ((j == 0 && specular_s) || (j == m && (specular_t || t > z->k)))) continue;
        ways++;
        if (path_specular(z, e) || path_specular(z, e + 1)) continue;
        Real p = 1;
        for (int i = s; i < e; i++) p *= pdf_to_lens(z, i, false) * (i < 0 ? 1 : 1 / (Real)z->v[i].inv_G);
        for (int i = t; i > e + 1; i--) p *= pdf_to_light(z, i, false) * (i > z->k ? 1 : 1 / (Real)z->v[i - 1].inv_G);
        sum += p;
    }
    return ways ? sum / ways : 0;
}

static Real slow_p_d1(int k, int k_d)
{
    Real sum = 0;
    for (int e = 1; e <= k + 2; e++) sum += raw_p_d1(e);
    return raw_p_d1(k_d) / sum;
}

static Real slow_p_a1(int k, int k_d, int k_a, int max_depth)
{
    Real sum = 0;
    for (int e = 1; e <= k_d - k + max_depth; e++)
        if (k - k_d + e >= 1) sum += raw_p_a1(e - k_d);
    return raw_p_a1(k_a - k_d) / sum;
}

static Real slow_p_d2(const Tuning *tuning, const Path *z, int s, int k_d)
{
    Real W = 0, mine = 0;
    int n = z->k + 3 - k_d;
    for (int i = -1; i + k_d <= z->k + 1; i++) {
        Real w = density_of_ways(z, i, i + k_d) / f_between(z, i, i + k_d) * (i < 0 ? tuning->light_scale : 1);
        W += w;
        if (i == s) mine = w;
    }
    return (1 - (Real)tuning->p_d2_importance) / n + (W > 0 ? tuning->p_d2_importance * mine / W : 0);
}

/* T(z|from), but for the density of steps, which is the same both ways. */
static Real slow_T(int row, const Space *space, const Tuning *tuning, const Path *from, const Path *z, int s, int k_d, int k_a, int m)
{
    Real T = 1;
    if (row == BIDIR)
        return slow_p_d1(from->k, k_d) * slow_p_d2(tuning, from, s, k_d) * slow_p_a1(from->k, k_d, k_a, space->max_depth) * density_of_ways(z, s, s + k_a);
    if (row == CAUSTIC)
        for (int i = m; i < z->k - 1; i++)
            T *= (i == m ? 1 / fabs(dot(z->v[i].to_lens, z->v[i].point.surface.ng)) : pdf_to_lens(z, i, true)) / z->v[i].inv_G;
    else
        for (int i = z->k; i > m; i--) {
            bool turned = row != SUBPATH && i < z->k && !path_specular(z, i);
            T *= (turned ? 1 / fabs(dot(z->v[i - 1].to_lens, z->v[i].point.surface.ng)) : pdf_to_light(z, i, row != SUBPATH)) / z->v[i - 1].inv_G;
        }
    return T;
}

/* All caches anew, from nothing but points and modes. */
static bool refresh(const Space *space, const Path *from, Path *to)
{
    path_copy(to, from);
    to->raster_x = to->raster_y = to->light_pdf_a = to->chi = NAN;
    to->pixel = 0;
    for (int i = 0; i <= to->k; i++) {
        Vertex fresh = { .point = to->v[i].point, .mode = to->v[i].mode };
        to->v[i] = fresh;
    }
    return path_evaluate(space, to) && to->chi > 0;
}

/* Relative difference of R(y|x)/R(x|y) as the row said it from f(y) T(x|y) / ( f(x) T(y|x) ) evaluated whole and from scratch. */
static double difference_of_R(int row, Lab *lab, const Space *space, const Tuning *tuning, const Path *x, const Path *y, const Move *move)
{
    if (!refresh(space, x, &lab->fresh_x) || !refresh(space, y, &lab->fresh_y)) return INFINITY;
    const Path *a = &lab->fresh_x, *b = &lab->fresh_y;
    int m = row == CAUSTIC ? move->first - 1 : move->first;
    Real f_x = a->chi * f_between(a, 0, a->k), f_y = b->chi * f_between(b, 0, b->k);
    Real there = slow_T(row, space, tuning, a, b, move->s, move->k_d, move->k_a, m), back = slow_T(row, space, tuning, b, a, move->s, move->k_a, move->k_d, m);
    if (isinf(move->R_xy) || back == 0) return isinf(move->R_xy) && back == 0 ? 0 : INFINITY;    /* no way back by either account */
    double difference = (double)fabsl((f_y * back) / (f_x * there) * move->R_xy / move->R_yx - 1);
    return isnan(difference) ? INFINITY : difference;
}

/* ---- the audit: do proposals follow T? ---- */

typedef struct {
    uint64_t proposals, outcome[OUTCOMES], accepted;
    double worst, chi_squared, z_flow;
    int freedom, states, classes;
    double sum[FAMILY * FAMILIES], square[FAMILY * FAMILIES], largest[FAMILY * FAMILIES];
} Finding;

/* Two samples of one distribution, or a sample and what is expected of it; bins of few counts are taken together. */
static void add_chi_squared(Finding *f, const double *a, const double *b, int bins, bool b_is_exact)
{
    double a_few = 0, b_few = 0;
    int used = 0;
    for (int i = 0; i <= bins; i++) {
        double p = i < bins ? a[i] : a_few, q = i < bins ? b[i] : b_few, expected = b_is_exact ? q : (p + q) / 2;
        if (i < bins && expected < AGAIN) { a_few += p; b_few += q; continue; }
        if (!(expected > 0)) continue;
        f->chi_squared += (p - q) * (p - q) / (b_is_exact ? q : p + q);
        used++;
    }
    if (used > 1) f->freedom += used - 1;
}

/* Bin of a step: how far, on a logarithmic scale, and whereto. */
static int step_bin(double u, double phi)
{
    int i = (int)floor(u * U_BINS), j = (int)floor((phi / (2 * PI) + 1) * PHI_BINS);
    return (i < 0 ? 0 : i < U_BINS ? i : U_BINS - 1) * PHI_BINS + j % PHI_BINS;
}

static int film_bin(const Space *space, int row, const Tuning *t, const Path *x, const Point *lens, Vec3 w)
{
    const Camera *camera = &space->scene->camera;
    double px, py, we;
    camera_project(camera, lens, w, &px, &py, &we);
    if (row == SUBPATH) return step_bin(px / camera->width, 2 * PI * py / camera->height);
    return step_bin(log(hypot(px - x->raster_x, py - x->raster_y) / t->r2) / t->log_r, atan2(py - x->raster_y, px - x->raster_x));
}

static int turn_bin(const Tuning *t, Vec3 old, Vec3 w)
{
    Vec3 a, b;
    frame(old, &a, &b);
    return step_bin(log(angle(old, w) / t->theta2) / t->log_theta, atan2(dot(w, b), dot(w, a)));
}

/* The kernels, written down a second time: a step on the film, or a turned direction; and where its ray ends, in the bins above. */
static int reference_film(const Space *space, int row, const Tuning *t, const Path *x, Rng *rng)
{
    const Camera *camera = &space->scene->camera;
    double u = rng_double(rng), phi = 2 * PI * rng_double(rng), r = t->r2 * exp(t->log_r * u), px = x->raster_x + r * cos(phi), py = x->raster_y + r * sin(phi);
    Point lens = x->v[x->k].point, hit;
    if (row == SUBPATH) {
        camera_sample_lens(camera, rng, &lens);
        px = u * camera->width;
        py = phi / (2 * PI) * camera->height;
    }
    if (!(px >= 0 && px < camera->width && py >= 0 && py < camera->height)) return BINS - 1;
    return scene_trace(space->scene, &lens, camera_direction(camera, &lens, px, py), &hit) ? film_bin(space, row, t, x, &lens, normalize(sub(hit.p, lens.p))) : BINS - 1;
}

static int reference_turn(const Space *space, const Tuning *t, const Point *at, Vec3 old, Rng *rng)
{
    double theta = t->theta2 * exp(t->log_theta * rng_double(rng)), phi = 2 * PI * rng_double(rng);
    Vec3 a, b;
    Point hit;
    frame(old, &a, &b);
    Vec3 w = along(along(scale(cos(theta), old), sin(theta) * cos(phi), a), sin(theta) * sin(phi), b);
    return scene_trace(space->scene, at, normalize(w), &hit) ? turn_bin(t, old, normalize(sub(hit.p, at->p))) : BINS - 1;
}

/* Many proposals from one x. bidir: labels (k_d, s, k_a), and j among its ways, against p_d1 p_d2 p_a1 p_a2. The others: where the first ray
 * goes, and for the chain the first turned one, against rays of our own; what is lost counts as a bin, so that no edge of the film matters. */
static void audit_proposals(Finding *f, int row, Lab *lab, const Space *space, const Sampler *sampler, const Path *x, uint64_t n, Rng *rng)
{
    const Tuning *t = &sampler->tuning;
    Path *y = &lab->after;
    static const int labels = K_BINS * S_BINS * K_BINS + 1;
    double seen[K_BINS * S_BINS * K_BINS + 1] = { 0 }, expected[K_BINS * S_BINS * K_BINS + 1] = { 0 };
    double turned_seen[BINS] = { 0 }, turned_expected[BINS] = { 0 }, j_seen[J_BINS] = { 0 }, j_expected[J_BINS] = { 0 };
    int turned = 0, m = row == CAUSTIC ? caustic_suffix(x) : row == BIDIR ? 0 : lens_suffix(x, &turned), d = x->k - 1;
    while (turned > 0 && path_specular(x, d)) d--;             /* the first vertex at which a direction is turned */
    for (uint64_t i = 0; i < n; i++) {
        Move move = { .s = 0 };
        for (int v = 0; v <= space->max_depth; v++) y->v[v].inv_G = -1;    /* an edge that is then positive has been traced */
        y->k = x->k;
        sampler->table[row].propose(space, t, x, y, rng, &move);
        if (row == BIDIR) {
            bool in = move.k_d <= K_BINS && move.k_a <= K_BINS && move.s + 1 < S_BINS;
            seen[in ? ((move.k_d - 1) * S_BINS + move.s + 1) * K_BINS + move.k_a - 1 : labels - 1]++;
            int t_new = move.s + move.k_a, ways = 0;
            if (move.s < x->k && bidir_ways(x, move.s, move.t, move.k_d - 1) > 0) ways = bidir_ways(y, move.s, t_new, move.k_a - 1);
            if (ways < 2) continue;
            int first = move.s >= 1 && material_is_specular(x->v[move.s].point.surface.material);
            double u = (move.j - first + rng_double(rng)) / ways;          /* uniform if j is uniform over its ways */
            j_seen[u >= 0 && u < 1 ? (int)(u * J_BINS) : 0] += u >= 0 && u < 1 ? 1 : (double)n;
            for (int b = 0; b < J_BINS; b++) j_expected[b] += 1.0 / J_BINS;
        } else if (row == CAUSTIC) {
            Vec3 old = x->v[m].to_lens, w = y->v[m].to_lens;
            seen[angle(old, w) > 0 ? turn_bin(t, old, w) : BINS - 1]++;
            expected[reference_turn(space, t, &x->v[m].point, old, rng)]++;
        } else {
            const Vertex *look = &y->v[y->k - 1];
            seen[look->inv_G > 0 ? film_bin(space, row, t, x, &y->v[y->k].point, neg(look->to_lens)) : BINS - 1]++;
            expected[reference_film(space, row, t, x, rng)]++;
            if (turned == 0 || !(y->v[d].inv_G > 0) || material_is_specular(y->v[d].point.surface.material)) continue;
            Vec3 old = neg(x->v[d - 1].to_lens);
            turned_seen[y->v[d - 1].inv_G > 0 ? turn_bin(t, old, neg(y->v[d - 1].to_lens)) : BINS - 1]++;
            turned_expected[reference_turn(space, t, &y->v[d].point, old, rng)]++;
        }
    }
    f->states++;
    if (row == BIDIR) {
        expected[labels - 1] = (double)n;
        for (int k_d = 1; k_d <= K_BINS && k_d <= x->k + 2; k_d++)
            for (int s = -1; s + 1 < S_BINS && s + k_d <= x->k + 1; s++)
                for (int k_a = 1; k_a <= K_BINS; k_a++) {
                    double p = bidir_p_d1(x->k, k_d) * bidir_p_d2(t, x, s, s + k_d) * bidir_p_a1(x->k, k_d, k_a, space->max_depth);
                    expected[((k_d - 1) * S_BINS + s + 1) * K_BINS + k_a - 1] = p * (double)n;
                    expected[labels - 1] -= p * (double)n;
                }
        add_chi_squared(f, seen, expected, labels, true);
        add_chi_squared(f, j_seen, j_expected, J_BINS, true);
    } else {
        add_chi_squared(f, seen, expected, BINS, false);
        add_chi_squared(f, turned_seen, turned_expected, BINS, false);
    }
}

/* A chi-square as a normal deviate [Wilson and Hilferty]. */
static double deviate(double chi_squared, int freedom)
{
    double v = 2 / (9.0 * freedom);
    return (cbrt(chi_squared / freedom) - 1 + v) / sqrt(v);
}

/* ---- the audit: does anything flow between classes? ----
 *
 * Starts follow f* exactly (a bidirectional sample is kept with a probability in proportion to its weight). A row in detailed balance lets as much
 * flow from any set of paths to any other as back, so over paths whose start weight is below a cap, which bounds every term of the sum,
 *     sum over starts and recorded states of weight ( g(state) - g(start) )     has expectation 0 for every function g of a path. */

/* f* over the density of a bidirectional sample, all techniques together: path_routes with the chance to go on. */
static double start_weight(const Path *x)
{
    double sum = path_inv_C(x, -1), grown = 1;
    for (int e = 0; e <= x->k; e++) {
        double before = e > 1 ? bsdf_albedo(&x->v[e - 1].point.surface) : 1, after = e + 1 < x->k ? bsdf_albedo(&x->v[e + 1].point.surface) : 1;
        grown *= path_inv_S_lens(x, e - 1) * before;
        sum = sum * path_inv_S_light(x, e + 1) * after + grown * path_inv_C(x, e);
    }
    return x->chi / sum;
}

static unsigned bin(double value_, double low, double step, unsigned bins)
{
    double i = floor((value_ - low) / step);
    return i > 0 ? i < bins ? (unsigned)i : bins - 1 : 0;
}

/* length x pattern at the lens x quarter of the film; pattern x probability of its modes; specular vertices x length of the edge at the lens */
static void classes(const Space *space, const Path *x, unsigned class[FAMILIES])
{
    const Camera *camera = &space->scene->camera;
    unsigned pattern = 0, specular = 0, quarter = (x->raster_x * 2 > camera->width) + 2u * (x->raster_y * 2 > camera->height);
    double q = 1;
    for (int i = 1; i <= 3; i++) pattern = 4 * pattern + (x->k - i > 0 ? (unsigned)x->v[x->k - i].mode : 3);
    for (int i = 1; i < x->k; i++)
        if (path_specular(x, i)) { specular += specular < 3; q *= x->v[i].s.q; }
    class[0] = ((unsigned)(x->k < 7 ? x->k : 7) * 64 + pattern) * 4 + quarter;
    class[1] = FAMILY + pattern * 4 + bin(log(q), -3, 1, 4);
    class[2] = 2 * FAMILY + specular * 64 + bin(log2(length(sub(x->v[x->k].point.p, x->v[x->k - 1].point.p))), -5, 0.125, 64);
}

typedef struct {
    const Space *space;
    double cap, total, flow[FAMILY * FAMILIES];
    unsigned touched[FAMILIES * (2 * FLOW_STEPS + 2)];
    int n;
} Flow;

static void add_flow(Flow *f, const Path *x, double weight)
{
    unsigned class[FAMILIES];
    classes(f->space, x, class);
    for (int i = 0; i < FAMILIES; i++) f->flow[f->touched[f->n++] = class[i]] += weight;
}

static void record_flow(void *context, const Path *x, double weight)
{
    Flow *f = context;
    if (!(start_weight(x) <= f->cap)) return;
    add_flow(f, x, weight);
    f->total += weight;
}

typedef struct { double cap, sum, octave[OCTAVE_BINS]; int n; Candidate all[ALL]; } Candidates;
static void collect(void *context, const Candidate *c)
{
    Candidates *all = context;
    all->octave[bin(log2(c->weight), -100, 0.25, OCTAVE_BINS)] += c->weight;
    if (c->weight > all->cap || all->n == ALL) return;
    all->all[all->n++] = *c;
    all->sum += c->weight;
}

static void sample_candidates(Lab *lab, const Space *space, Rng *rng, Candidates *all)
{
    const Camera *camera = &space->scene->camera;
    double px = rng_double(rng) * camera->width, py = rng_double(rng) * camera->height;
    all->n = 0;
    all->sum = 0;
    bdpt_sample(lab->bdpt, space, px, py, rng, collect, all);
}

/* Returns the worst relative difference between a start's weight and the sampler's. */
static double audit_flows(Finding *finding, Lab *lab, const Space *space, const Sampler *sampler, uint64_t n, uint64_t seed, Candidates *all, Flow *flow)
{
    Rng rng = rng_new(seed, (uint64_t)3 << 40);
    double below = 0, worst = 0;
    all->cap = INFINITY;
    for (uint64_t i = 0; i < n; i++) sample_candidates(lab, space, &rng, all);
    for (int i = 0; i < OCTAVE_BINS; i++) {    /* the largest cap with which one sample in KEEP still makes a start */
        double cap = exp2(-100 + 0.25 * (i + 1));
        below += all->octave[i];
        if (below * KEEP >= cap * (double)n) all->cap = cap;
    }
    flow->space = space;
    flow->cap = all->cap;
    for (uint64_t i = 0, starts = 0; i < KEEP * n && starts < n; i++) {
        sample_candidates(lab, space, &rng, all);
        if (rng_double(&rng) * all->cap >= all->sum) continue;
        double W = larger(all->sum, all->cap), left = rng_double(&rng) * all->sum;
        int c = 0;
        while (c < all->n - 1 && left >= all->all[c].weight) left -= all->all[c++].weight;
        if (!bdpt_path(lab->bdpt, space, all->all[c].n_light, all->all[c].n_lens, &lab->before)) { worst = INFINITY; continue; }
        worst = fmax(worst, fabs(start_weight(&lab->before) / all->all[c].weight - 1));
        starts++;
        for (int r = 0; r < sampler->rows; r++) {
            if (!(sampler->share[r] > 0) || !sampler->table[r].applies(space, &lab->before)) continue;
            Sampler alone = *sampler;
            ChainCount count = { .steps = 0 };
            for (int other = 0; other < sampler->rows; other++) alone.share[other] = other == r;
            path_copy(&lab->x, &lab->before);
            flow->n = 0;
            flow->total = 0;
            chain_run(space, &alone, &lab->x, &lab->y, FLOW_STEPS, &rng, record_flow, flow, &count);
            add_flow(flow, &lab->before, -flow->total);
            for (int j = 0; j < flow->n; j++) {
                unsigned k = flow->touched[j];
                double moved = W * flow->flow[k];
                flow->flow[k] = 0;
                finding[r].sum[k] += moved;
                finding[r].square[k] += moved * moved;
                finding[r].largest[k] = fmax(finding[r].largest[k], moved * moved);
            }
        }
    }
    for (int r = 0; r < sampler->rows; r++)
        for (int k = 0; k < FAMILY * FAMILIES; k++) {
            Finding *f = &finding[r];
            if (!(f->square[k] > ENOUGH * f->largest[k])) continue;        /* too few for a sum to be normal */
            f->z_flow = fmax(f->z_flow, fabs(f->sum[k]) / sqrt(f->square[k]));
            f->classes++;
        }
    return worst;
}

/* ---- the audit: all of it ---- */

/* |z| that one of so many comparisons passes by chance with probability 'alarm' */
static double limit(int comparisons, double alarm)
{
    double low = 0, high = 30;
    while (high - low > 1e-6) {
        double z = (low + high) / 2;
        if (comparisons * erfc(z / sqrt(2)) > alarm) low = z;
        else high = z;
    }
    return high;
}

/* Every row proposes from every state of a chain that uses them all; now and then the same state serves for a histogram. */
static void audit_states(Finding *finding, Lab *lab, const Space *space, const Sampler *sampler, uint64_t n, uint64_t seed)
{
    Rng own = rng_new(seed, (uint64_t)2 << 40);
    for (uint64_t step = 0; step < n; step++) {
        if (step % AGAIN == 0 && !bootstrap_seed(&lab->seeds, space, lab->bdpt, rng_double(&own), &lab->x)) return;
        ChainCount count = { .steps = 0 };
        Weights weights = { .n = 0 };
        chain_run(space, sampler, &lab->x, &lab->y, 1, &own, keep_weight, &weights, &count);
        for (int r = 0; r < sampler->rows; r++) {
            Finding *f = &finding[r];
            if (!(sampler->share[r] > 0) || !sampler->table[r].applies(space, &lab->x)) continue;
            Move move;
            Path *y = &lab->after;
            Outcome outcome = sampler->table[r].propose(space, &sampler->tuning, &lab->x, y, &own, &move);
            f->proposals++;
            if (outcome == PROPOSED) {
                f->worst = fmax(f->worst, difference_of_R(r, lab, space, &sampler->tuning, &lab->x, y, &move));
                if (isinf(move.R_xy)) outcome = ZERO_NO_WAY;
                else if (move.joined >= 0 && !scene_visible(space->scene, &y->v[move.joined].point, &y->v[move.joined + 1].point)) outcome = ZERO_BLOCKED;
                else f->accepted += rng_double(&own) * move.R_xy < move.R_yx && sampler->table[r].applies(space, y);
            }
            f->outcome[outcome]++;
            if (step % AGAIN == 1 && f->states < STATES) audit_proposals(f, r, lab, space, sampler, &lab->x, n / STATES, &own);
        }
    }
}

static bool audit(Lab *lab, const Space *space, const Sampler *sampler, const ExplainOptions *o, FILE *out, Report *report)
{
    uint64_t n = o->proposals ? o->proposals : audit_count;
    int flows = 0, histograms = 0;
    bool ok = true;
    Finding *finding = calloc((size_t)sampler->rows, sizeof *finding);
    Candidates *all = calloc(1, sizeof *all);
    Flow *flow = calloc(1, sizeof *flow);
    if (!finding || !all || !flow) {
        free(finding); free(all); free(flow);
        return report_error(report, NULL, 0, "out of memory");
    }
    audit_states(finding, lab, space, sampler, n, o->seed);
    double start_error = audit_flows(finding, lab, space, sampler, n, o->seed, all, flow);
    for (int r = 0; r < sampler->rows; r++) {
        flows += finding[r].classes;
        histograms += finding[r].freedom > 0;
    }
    double flow_limit = limit(flows, false_alarm / 2), histogram_limit = limit(histograms, false_alarm / 2);
    fprintf(out, "Audit of each strategy: R of every proposal against f/T evaluated whole and from scratch (relative difference, at most %.0e), proposals from\n"
            "fixed x against T (z at most %.2f), and flows between classes of paths from exact starts (z at most %.2f).\n\n"
            "%-8s %10s %10s %10s %12s %10s %8s %10s %8s   zero because\n", worst_allowed, histogram_limit, flow_limit,
            "strategy", "proposals", "zero", "accepted", "difference", "proposals", "", "flows", "");
    fprintf(out, "%-8s %10s %10s %10s %12s %10s %8s %10s %8s\n", "", "", "", "", "worst of R", "freedom", "z", "classes", "z");
    for (int r = 0; r < sampler->rows; r++) {
        const Finding *f = &finding[r];
        if (!(sampler->share[r] > 0)) continue;
        uint64_t zero = f->proposals - f->outcome[PROPOSED];
        double z = f->freedom ? deviate(f->chi_squared, f->freedom) : 0;
        bool good = f->worst <= worst_allowed && fabs(z) <= histogram_limit && f->z_flow <= flow_limit;
        fprintf(out, "%-8s %10" PRIu64 " %10" PRIu64 " %10" PRIu64 " %12.2e %10d %8.2f %10d %8.2f  ", sampler->table[r].name, f->proposals, zero, f->accepted, f->worst,
                f->freedom, z, f->classes, f->z_flow);
        for (int i = PROPOSED + 1; i < OUTCOMES; i++)
            if (f->outcome[i]) fprintf(out, " %s %" PRIu64, outcome_name[i], f->outcome[i]);
        fprintf(out, "%s%s\n", f->proposals ? "" : " nothing proposed: no path that it applies to was met", good ? "" : "   OFF");
        ok &= good;
    }
    fprintf(out, "\nStart weights by a second route: worst relative difference %.2e%s\n", start_error, start_error <= worst_allowed ? "" : "   OFF");
    ok &= start_error <= worst_allowed;
    free(finding);
    free(all);
    free(flow);
    return ok || report_error(report, NULL, 0, "the audit found something off");
}

bool explain(const Space *space, const Sampler *sampler, const ExplainOptions *o, FILE *out, Report *report)
{
    int row = -1;
    for (int r = 0; r < sampler->rows; r++)
        if (o->strategy && strcmp(sampler->table[r].name, o->strategy) == 0) row = r;
    if (o->strategy && row < 0) return report_error(report, NULL, 0, "there is no strategy '%s'", o->strategy);
    if (o->strategy && !(sampler->share[row] > 0)) return report_error(report, NULL, 0, "'%s' is not among the strategies, or of no use in a scene without mirrors and glass", o->strategy);
    if (o->example && o->strategy && row != BIDIR) return report_error(report, NULL, 0, "the lecture's examples are mutations by '%s'", sampler->table[BIDIR].name);
    Lab *lab = calloc(1, sizeof *lab);
    bool ok = lab && (lab->bdpt = bdpt_new()) && bootstrap_run(&lab->seeds, space, lab->bdpt, o->bootstrap ? o->bootstrap : default_count, o->seed, (uint64_t)1 << 32);
    if (!ok) report_error(report, NULL, 0, "out of memory");
    else if (!(lab->seeds.b > 0)) ok = report_error(report, NULL, 0, "no light reaches the camera on any of %" PRIu64 " paths: nothing to mutate", lab->seeds.n);
    else ok = o->audit ? audit(lab, space, sampler, o, out, report) : explain_one(lab, space, sampler, o, out, report);
    if (lab) {
        bdpt_free(lab->bdpt);
        bootstrap_free(&lab->seeds);
    }
    free(lab);
    return ok;
}
