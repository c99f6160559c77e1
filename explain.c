/* One mutation with all of its numbers. See explain.h.
 *
 *   names     x_i, z_0 .. for what is new in y, and F(a,b,c) G(a,b) C(a,b,c,d) S>(a,b,c) S<(a,b,c) as in path.h; a dot stands where a path has ended
 *   one half  R(y|x) or R(x|y) of a bidirectional mutation                                  [lecture: Probabilities; Finding T(y|x)]
 *   examples  the same in the slides' own forms, their slips corrected                      [lecture: Example I fleshed out; Example 2]
 *   the rest  R of the other mutations, the acceptance, and the search for a mutation               [lecture: Pending; AcceptProb]
 *
 * Decides nothing: R, a and what became of y are the chain's, and what is printed before them are the cached numbers that they should follow from.
 * Must not know how y was sampled (it replays the row), nor how the audit works. */
#include "explain.h"
#include "audit.h"
#include <inttypes.h>
#include <string.h>

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

static void print_chi(FILE *out, const Named *n, const char *name)
{
    fprintf(out, "  chi(%s) = %.9g    colours apart: w(pixel) luminance(product of f_s^rgb / F)\n", name, n->path->chi);
}

/* ---- the bidirectional mutation ---- */

/* One half of a mutation: 'from' loses its segment s .. t, 'to' has s .. t_to in its place. The numbers are the move's. */
typedef struct {
    const Named *from, *to;
    const char *x, *y;                         /* their names */
    int s, t, t_to, taken;                     /* taken: the way j by which it came; -1 for the way back */
    double p_d1, p_d2, p_a1, p_a2, routes, R;
} Half;

static double p_d(const Half *h) { return h->p_d1 * h->p_d2; }
static double p_a(const Half *h) { return h->p_a1 * h->p_a2; }

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

static void print_deletion(FILE *out, const Half *h, const Tuning *tuning)
{
    const Path *p = h->from->path;
    int k_d = h->t - h->s, n = p->k + 3 - k_d;
    double share = tuning->p_d2_importance, W = 0, mine = 0;
    fprintf(out, "  delete: s = %d, t = %d, k_d = t - s = %d of %d edges [lecture: Choosing a segment to delete; Deletion Probability]\n",
            h->s, h->t, k_d, p->k);
    fprintf(out, "    p_d1^%s[%d] = %.9g / (1 - %.9g) = %.9g    1/4, 1/2, 2^-e; cut at k + 2 and normalised again\n", h->x, k_d,
            raw_p_d1(k_d), ldexp(1, -(p->k + 2)), h->p_d1);
    fprintf(out, "    w^%s[s,t], the computable part of 1/R(%s|%s), for each segment of %d edge%s%s:\n     ", h->x, h->x, h->y, k_d, k_d > 1 ? "s" : "",
            tuning->light_scale != 1 ? " (with s = -1 times light_scale)" : "");
    for (int s = -1; s <= p->k + 1 - k_d; s++) {
        double w = bidir_w(p, s, s + k_d) * (s < 0 ? tuning->light_scale : 1);
        W += w;
        if (s == h->s) mine = w;
        fprintf(out, " w^%s[%d,%d] = %.9g%s", h->x, s, s + k_d, w, s == p->k + 1 - k_d ? "\n" : ";");
    }
    fprintf(out, "    W^%s(%d) = sum of these = %.9g\n", h->x, k_d, W);
    fprintf(out, "    p_d2^%s[%d,%d] = share uniform over %d segments, the rest w/W = %.9g / %d + %.9g * %.9g / %.9g = %.9g\n", h->x, h->s, h->t,
            n, 1 - share, n, share, mine, W, h->p_d2);
    fprintf(out, "    p_d^%s[%d,%d] = p_d1 p_d2 = %.9g * %.9g = %.9g\n", h->x, h->s, h->t, h->p_d1, h->p_d2, p_d(h));
}

static void print_half(FILE *out, const Half *h, const Tuning *tuning)
{
    const Path *z = h->to->path;
    int k_d = h->t - h->s, k_a = h->t_to - h->s, m = k_a - 1, ways = (int)lround(1 / h->p_a2);
    double term[MAX_EDGES + 2];                /* p_a/Q of each way, 0 where there is none */
    const char *sign = "";
    char text[TEXT];
    bool possible;
    print_deletion(out, h, tuning);
    fprintf(out, "  add: k_a = %d edge%s, so m = s' + t' = %d new vert%s [lecture: Choosing a segment to add]\n", k_a,
            k_a > 1 ? "s" : "", m, m == 1 ? "ex" : "ices");
    fprintf(out, "    p_a1^%s[%d] = %.9g / %.9g = %.9g    1/2, 0.15, 0.15, rest; cut and normalised again\n", h->x, k_a,
            raw_p_a1(k_a - k_d), raw_p_a1(k_a - k_d) / h->p_a1, h->p_a1);
    fprintf(out, "    p_a^%s[s',t'] = p_a1 / %d possible = %.9g / %d = %.9g\n", h->x, ways, h->p_a1, ways, p_a(h));
    fprintf(out, "  what the ways are made of, along %s:\n", h->y);
    print_numbers_along(out, h->to, h->s, h->t_to);
    fprintf(out, "  the ways [s',t'] to make %s from %s, Q = f over density [lecture: T(y|x) must take all possible routes into account]\n", h->y, h->x);
    for (int j = 0; j <= m; j++) {
        term[j] = 0;
        if (no_way(h, j, &possible, text)) {
            fprintf(out, "    [%d,%d]  p_a/Q^%s = 0: %s%s\n", j, m - j, h->x, text, possible ? "" : ", so p_a = 0");
            continue;
        }
        Product q = way(h->s, h->t_to, j);
        fprintf(out, "    Q^%s[%d,%d] = ", h->x, j, m - j);
        print_product(out, h->to, &q, false);
        fputs(" = ", out);
        print_product(out, h->to, &q, true);
        double Q = product(z, &q);
        term[j] = p_a(h) / Q;
        fprintf(out, " = %.9g%s\n", Q, j == h->taken ? "    <- taken" : "");
        fprintf(out, "      p_a/Q^%s[%d,%d] = %.9g / %.9g = %.9g\n", h->x, j, m - j, p_a(h), Q, term[j]);
    }
    fprintf(out, "  sum^%s = ", h->x);
    for (int j = 0; j <= m; j++) {
        if (!(term[j] > 0)) continue;
        fprintf(out, "%s%.9g", sign, term[j]);
        sign = " + ";
    }
    fprintf(out, " = %.9g\n", p_a(h) * h->routes);
    print_chi(out, h->to, h->y);
    fprintf(out, "  R(%s|%s) = f(%s)/T(%s|%s) = chi(%s) / ( p_d^%s[%d,%d] sum^%s ) = %.9g / (%.9g * %.9g) = %.9g\n", h->y, h->x, h->y, h->y, h->x, h->y,
            h->x, h->s, h->t, h->x, z->chi, p_d(h), p_a(h) * h->routes, h->R);
}

/* ---- the lecture's two examples ---- */

/* R as f/T with nothing cancelled but the factors that x and y share: f_s and G above, p_d, p_a, p_s and G below. */
static void print_plain(FILE *out, const Half *h)
{
    const Path *z = h->to->path;
    int m = h->t_to - h->s - 1;
    Product f = { .n = 0 };
    for (int i = h->s; i <= h->t_to; i++) {
        times(&f, F_, i);
        if (i < h->t_to) times(&f, G_, i);
    }
    for (int numbers = 0; numbers <= 1; numbers++) {
        if (numbers) fprintf(out, "      = %.9g * ", z->chi);
        else fprintf(out, "    R(%s|%s) = chi(%s) ", h->y, h->x, h->y);
        print_product(out, h->to, &f, numbers);
        if (numbers) fprintf(out, " / (%.9g * (", p_d(h));
        else fprintf(out, " / ( p_d^%s[%d,%d] ( ", h->x, h->s, h->t);
        for (int j = 0; j <= m; j++) {
            Product p = { .n = 0 };
            for (int i = h->s; i < h->s + j; i++) times(&p, P_LENS, i), times(&p, G_, i);
            for (int i = h->t_to; i > h->s + j + 1; i--) times(&p, P_LIGHT, i), times(&p, G_, i - 1);
            if (numbers) fprintf(out, "%s%.9g * ", j ? " + " : "", p_a(h));
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
    double chi = z->chi, K = p_d(h), A = p_a(h), f1 = value_F(z, s), f2 = value_F(z, s + 1), f3 = value_F(z, s + 2);
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
    fprintf(out, "      = %.9g * (%.9g * %.9g / %.9g) / (%.9g * (%.9g * %.9g * %.9g / %.9g + %.9g * %.9g * %.9g / %.9g)) = %.9g\n",
            chi, C1, C2, f2, K, A, f1, G1, S1, A, f3, G2, S2, h->R);
    fprintf(out, "    R(%s|%s) = chi (C C' / %s) / ( K ( A C / S + B C' / S' ) / %s )\n", h->y, h->x, f[1], f[1]);
    fprintf(out, "      = %.9g * (%.9g * %.9g / %.9g) / (%.9g * (%.9g * %.9g / %.9g + %.9g * %.9g / %.9g) / %.9g) = %.9g\n",
            chi, C1, C2, f2, K, A, C1, S1, A, C2, S2, f2, h->R);
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
        for (int i = m; i < p->k - 1; i++) times(&r, path_specular(p, i) ? COPIED_LENS : TURNED_LENS, i);
        times(&r, C_, p->k - 1);
        return r;
    }
    times(&r, C_, m - 1);
    for (int i = m + 1; i < p->k; i++) times(&r, row == SUBPATH ? S_LIGHT : path_specular(p, i) ? COPIED_LIGHT : TURNED_LIGHT, i);
    return r;
}

/* 'spread' is 0 where there is none. */
static void print_R(FILE *out, int row, const Named *n, const char *y, const char *x, int m, double spread, double R)
{
    Product p = perturbation_R(row, n->path, m);
    fprintf(out, "  along %s:\n", y);
    print_numbers_along(out, n, m > 0 ? m - 1 : row == CAUSTIC ? 0 : -1, n->path->k);
    print_chi(out, n, y);
    fprintf(out, "  R(%s|%s) = chi(%s) ", y, x, y);
    print_product(out, n, &p, false);
    fprintf(out, "%s = %.9g * ", spread > 0 ? " |dw/dx_0|" : "", n->path->chi);
    print_product(out, n, &p, true);
    if (spread > 0) fprintf(out, " * %.9g", spread);
    fprintf(out, " = %.9g\n", R);
}

static void print_turn(FILE *out, const Tuning *t, Vec3 old, Vec3 new)
{
    fprintf(out, " is turned by %.6g radians, of steps from %.6g to %.6g\n", angle(old, new), t->theta2 * exp(t->log_theta), t->theta2);
}

/* The vertex is passed by a narrow lobe, from the lens or towards it. */
static void print_lobe(FILE *out, const Named *n, int i, bool to_light)
{
    const Passage passage = path_passage(n->path, i, to_light);
    char name[16];
    fprintf(out, "  at %s light keeps its place in the narrow lobe, %.6g radians off the mirror image\n", vertex_name(n, i, name), angle(passage.mirrored, passage.w));
}

static void print_perturbation(FILE *out, int row, const Tuning *t, const Named *x, const Named *y, const Move *move)
{
    const Path *a = x->path, *b = y->path;
    int m = row == CAUSTIC ? move->first - 1 : move->first;
    char name[16];
    fprintf(out, "\nMOVE  x_%d .. x_%d are replaced [lecture: 'two other mutation strategies']\n", move->first, move->last);
    if (row == CAUSTIC) {
        fprintf(out, "  the direction from x_%d towards the lens", m);
        print_turn(out, t, a->v[m].to_lens, b->v[m].to_lens);
    } else {
        if (row == SUBPATH)
            fprintf(out, "  a fresh raster position, uniform over the film%s", y->first + y->count > b->k ? ", and a fresh point of the lens" : "");
        else fprintf(out, "  the raster position moves by %.6g pixels, of steps from %.6g to %.6g",
                     hypot(b->raster_x - a->raster_x, b->raster_y - a->raster_y), t->r2 * exp(t->log_r), t->r2);
        fprintf(out, ": from (%.4f, %.4f) to (%.4f, %.4f)\n", a->raster_x, a->raster_y, b->raster_x, b->raster_y);
    }
    for (int i = b->k - 2; i > m && row == CAUSTIC; i--)
        if (!path_specular(b, i)) print_lobe(out, y, i, false);
    for (int i = b->k - 1; i > m && row != CAUSTIC && row != SUBPATH; i--) {
        if (path_specular(b, i)) continue;
        if (path_sharp(b, i)) {
            print_lobe(out, y, i, true);
            continue;
        }
        if (row == MANIFOLD && i == manifold_diffuse(b)) {
            fprintf(out, "  at %s the direction is searched for that leads to the same x_0\n", vertex_name(y, i, name));
            continue;
        }
        fprintf(out, "  at %s the old direction towards the light", vertex_name(y, i, name));
        print_turn(out, t, a->v[i - 1].to_lens, b->v[i - 1].to_lens);
    }
    fputs(row == SUBPATH
          ? "  The modes are drawn: S = F/q stays a ratio. What both directions share, the density over the film, cancels.\n"
          : "  Modes are copied, not drawn: q counts as 1, and q S = F stands where S = F/F would. A turned direction leaves F |cos|, and\n"
            "  so does a copied place in a narrow lobe. Steps are as likely there as back, so their density cancels.\n", out);
    fputs("\nTHERE\n", out);
    print_R(out, row, y, "y", "x", m, move->spread_y, move->R_yx);
    fputs("\nAND BACK\n", out);
    print_R(out, row, x, "x", "y", m, move->spread_x, move->R_xy);
}

/* ---- a step of the chain ---- */

typedef struct {
    Path x, y, before, after;
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
    if ((o->accepted && !step->accepted) || (o->length && x->k != o->length) ||
        (o->strategy && strcmp(sampler->table[step->row].name, o->strategy) != 0)) return false;
    if (step->row == BIDIR && m->k_d == 1 && m->k_a == 1) return false;    /* y = x */
    bool specular = !sampler->table[step->row].needs_sharp;             /* such a row is best seen at a path that needs it */
    for (int i = m->first; i <= m->last; i++) specular |= path_sharp(x, i);
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
        if (!may_choose(space, s, x, r)) continue;
        fprintf(out, "%s%.9g", first ? "" : " + ", s->share[r]);
        sum += s->share[r];
        first = false;
    }
    double q = s->table[row].applies(space, x) ? s->share[row] / sum : 0;
    fprintf(out, ") = %.9g    of", q);
    for (int r = 0; r < s->rows; r++)
        if (may_choose(space, s, x, r)) fprintf(out, " %s", s->table[r].name);
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
    if (m->joined >= 0)
        fprintf(out, "  V(%s,%s) = %d    %s\n", vertex_name(&new, m->joined, a), vertex_name(&new, m->joined + 1, b), V,
                V ? "nothing is in between" : "blocked, f(y) = 0");
    else fputs("  V = 1    no edge was joined: all were traced\n", out);
    fprintf(out, "  a(y|x) = V min(1, R(y|x) q(y) / ( R(x|y) q(x) )) = %d * min(1, %.9g * %.9g / (%.9g * %.9g)) = %.9g\n",
            V, m->R_yx, q_y, m->R_xy, q_x, step->a);
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

/* ---- either ---- */

bool explain(const Space *space, const Sampler *sampler, const ExplainOptions *o, FILE *out, Report *report)
{
    int row = -1;
    for (int r = 0; r < sampler->rows; r++)
        if (o->strategy && strcmp(sampler->table[r].name, o->strategy) == 0) row = r;
    if (o->strategy && row < 0) return report_error(report, NULL, 0, "there is no strategy '%s'", o->strategy);
    if (o->strategy && !(sampler->share[row] > 0))
        return report_error(report, NULL, 0, "'%s' is not among the strategies, or of no use in a scene without mirrors and glass", o->strategy);
    if (o->example && o->strategy && row != BIDIR)
        return report_error(report, NULL, 0, "the lecture's examples are mutations by '%s'", sampler->table[BIDIR].name);
    Lab *lab = calloc(1, sizeof *lab);
    uint64_t samples = o->bootstrap ? o->bootstrap : default_count;
    bool ok = lab && (lab->bdpt = bdpt_new()) && bootstrap_run(&lab->seeds, space, lab->bdpt, samples, o->seed, (uint64_t)1 << 32);
    if (!ok) report_error(report, NULL, 0, "out of memory");
    else if (!(lab->seeds.b > 0))
        ok = report_error(report, NULL, 0, "no light reaches the camera on any of %" PRIu64 " paths: nothing to mutate", lab->seeds.n);
    else if (o->audit) ok = audit(space, sampler, row, &lab->seeds, lab->bdpt, o->proposals ? o->proposals : audit_count, o->seed, out, report);
    else ok = explain_one(lab, space, sampler, o, out, report);
    if (lab) {
        bdpt_free(lab->bdpt);
        bootstrap_free(&lab->seeds);
    }
    free(lab);
    return ok;
}
