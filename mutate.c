/* The bidirectional mutation. [lecture: bidirectional mutation, PART A and B; Veach ch. 11.4]
 *
 * Delete: k_d = t-s edges between x_s and x_t, -1 <= s < t <= k+1 (the slides' 'possible values for s and t are ???').
 * Add:    k_a edges, m = k_a - 1 vertices, j of them grown from x_s and m - j from x_t, then one edge that joins the two.
 *
 *     p_d[s,t] = p_d1[k_d] p_d2[s,t]         p_a[j] = p_a1[k_a] p_a2[j], p_a2 uniform over the ways that exist
 *     T(y|x)   = p_d p_a1 * sum over j of p_a2[j] * density of way j,     f(y) / density = chi Q_j
 *     R(y|x)   = chi(y) / ( p_d p_a1 * sum_j p_a2[j] / Q_j )
 *
 * The label (s, k-t, k_d, k_a) is one strategy of 'for each strategy i'; the reverse move has k_d and k_a exchanged. Balance holds label by
 * label, so other (s,t) that could lead to the same y need not be summed.
 */
#include "mutate.h"
#include <string.h>

const char *const outcome_name[OUTCOMES] = { "proposed", "no_way", "lost", "side", "film", "class", "blocked" };

static double half_to(int n) { return n < 63 ? 1 / (double)((uint64_t)1 << n) : ldexp(1, -n); }

/* 1/4, 1/2, 2^-e; cut at k+2, where the sum is 1 - 2^-(k+2). */
double bidir_p_d1(int k, int k_d)
{
    double p = k_d == 1 ? 0.25 : k_d == 2 ? 0.5 : half_to(k_d);
    return p / (1 - half_to(k + 2));
}

static int draw_k_d(int k, Rng *rng)
{
    double u = rng_double(rng) * (1 - half_to(k + 2));
    if (u < 0.5) return 2;
    if (u < 0.75) return 1;
    int e = 3;
    for (double edge = 0.875, step = 0.0625; u >= edge && e < k + 2; edge += step, step /= 2) e++;
    return e;
}

/* Mass of p_a1 on one side, |d| = 1 .. n: 0.15 + 0.1 (1/2 + 1/4 + ..) */
static double one_side(int n) { return n <= 0 ? 0 : 0.15 + 0.1 * (1 - half_to(n - 1)); }

/* How far k_a may lie below and above k_d: k_a >= 1 and 1 <= k' <= max_depth. */
static int room_below(int k, int k_d) { return k_d < k ? k_d - 1 : k - 1; }
static int room_above(int k, int max_depth) { return max_depth - k; }

double bidir_p_a1(int k, int k_d, int k_a, int max_depth)
{
    int d = k_a - k_d, below = room_below(k, k_d), above = room_above(k, max_depth), distance = d < 0 ? -d : d;
    if (distance > 0 && distance > (d < 0 ? below : above)) return 0;
    double p = d == 0 ? 0.5 : distance == 1 ? 0.15 : 0.1 * half_to(distance - 1);
    return p / (0.5 + one_side(below) + one_side(above));
}

static int draw_k_a(int k, int k_d, int max_depth, Rng *rng)
{
    double below = one_side(room_below(k, k_d)), above = one_side(room_above(k, max_depth));
    double u = rng_double(rng) * (0.5 + below + above) - 0.5;
    if (u < 0) return k_d;
    int sign = u < below ? -1 : 1, room = sign < 0 ? room_below(k, k_d) : room_above(k, max_depth), n = 1;
    if (sign > 0) u -= below;
    for (double edge = 0.15, step = 0.05; u >= edge && n < room; edge += step, step /= 2) n++;
    return k_d + sign * n;
}

/* A way joins u_j and u_{j+1}. j = 0 needs x_s to be joinable, j = m needs x_t to be; what else is possible depends on the ends alone and
 * never on the new vertices, so that proposal and weights agree. */
int bidir_ways(const Path *z, int s, int t, int m)
{
    if (s == z->k) return 0;                                     /* nothing grows from the lens */
    if (s < 0 && m == 0) return t < z->k && material_emits(z->v[t].point.surface.material);
    bool first = s < 1 || !material_is_specular(z->v[s].point.surface.material);
    bool last = t == z->k || (t < z->k && !material_is_specular(z->v[t].point.surface.material));
    if (m == 0) return first && last;
    return m + 1 - !first - !last;
}

double bidir_w(const Path *z, int s, int t)
{
    int ways = bidir_ways(z, s, t, t - s - 1);
    return ways == 0 ? 0 : path_routes(z, s, t) / ways;
}

/* w of all segments of k_d edges, s = -1 .. k+1-k_d, in w[s+1]; returns their sum W. The same as bidir_w one by one, but the recurrence of path_routes
 * goes over all s at once and has no branches. [lecture: Deletion Probability, the computable part of 1/R(x|y)] */
static double segment_weights(const Tuning *tuning, const Path *z, int k_d, double w[MAX_EDGES + 3])
{
    /* From here on index i+1 belongs to i of the path; grown: prod 1/S> from v[s] on. */
    double inv_C[MAX_EDGES + 3], inv_S_lens[MAX_EDGES + 3], inv_S_light[MAX_EDGES + 3], grown[MAX_EDGES + 3], W = 0;
    int joinable[MAX_EDGES + 3], n = z->k + 3 - k_d, m = k_d - 1;
    for (int i = 0; i <= z->k; i++) {
        const Vertex *v = &z->v[i];
        inv_C[i + 1] = path_inv_C(z, i);
        inv_S_lens[i + 1] = v->s.inv_S_lens;
        inv_S_light[i + 1] = v->s.inv_S_light;
        joinable[i + 1] = i == 0 || i == z->k || !material_is_specular(v->point.surface.material);
    }
    inv_C[0] = path_inv_C(z, -1);
    inv_S_lens[0] = path_inv_S_lens(z, -1);
    inv_S_light[z->k + 2] = path_inv_S_light(z, z->k + 1);
    inv_C[z->k + 2] = 0;
    joinable[0] = 1;
    joinable[z->k + 2] = 0;
    for (int s = 0; s < n; s++) {
        w[s] = inv_C[s];
        grown[s] = 1;
    }
    for (int d = 1; d < k_d; d++)
        for (int s = 0; s < n; s++) {
            grown[s] *= inv_S_lens[s + d - 1];
            w[s] = w[s] * inv_S_light[s + d + 1] + grown[s] * inv_C[s + d];
        }
    /* bidir_ways */
    double per_way[3] = { m > 1 ? 1.0 / (m - 1) : 0, m > 0 ? 1.0 / m : 0, 1.0 / (m + 1) };
    w[0] *= tuning->light_scale;
    for (int s = 0; s < n; s++) W += w[s] *= per_way[joinable[s] + joinable[s + k_d]];
    return W;
}

double bidir_p_d2(const Tuning *tuning, const Path *z, int s, int t)
{
    double importance = tuning->p_d2_importance, uniform = (1 - importance) / (z->k + 3 - (t - s)), w[MAX_EDGES + 3];
    if (importance == 0) return uniform;
    double W = segment_weights(tuning, z, t - s, w);
    return W > 0 ? uniform + importance * w[s + 1] / W : uniform;
}

/* The first vertex of the segment. */
static int draw_s(const Tuning *tuning, const Path *x, int k_d, Rng *rng)
{
    int last = x->k + 1 - k_d, s = -1;
    if (tuning->p_d2_importance == 0 || rng_double(rng) >= tuning->p_d2_importance) return (int)rng_index(rng, (uint32_t)last + 2) - 1;
    double w[MAX_EDGES + 3], left = rng_double(rng) * segment_weights(tuning, x, k_d, w);
    while (s < last && (left -= w[s + 1]) >= 0) s++;
    return s;
}

bool bidir_applies(const Space *space, const Path *x) { (void)space; (void)x; return true; }

Outcome bidir_propose(const Space *space, const Tuning *tuning, const Path *x, Path *y, Rng *rng, Move *move)
{
    int k_d = draw_k_d(x->k, rng), s = draw_s(tuning, x, k_d, rng), t = s + k_d;
    int k_a = draw_k_a(x->k, k_d, space->max_depth, rng), m = k_a - 1, t_new = s + k_a;
    *move = (Move){ .s = s, .t = t, .k_d = k_d, .k_a = k_a };
    int ways_x = bidir_ways(x, s, t, k_d - 1);
    if (s == x->k || ways_x == 0) return ZERO_NO_WAY;            /* cannot be regrown: there would be no way back */

    /* y = x_0 .. x_s  z_1 .. z_m  x_t .. x_k */
    y->k = x->k - k_d + k_a;
    y->light_pdf_a = x->light_pdf_a;
    y->known = x->known;
    y->raster_x = x->raster_x;
    y->raster_y = x->raster_y;
    y->pixel = x->pixel;
    int near_s = s < 1 ? 0 : s - 1, near_t = t < x->k ? t : x->k;    /* what growth and the ends' scattering read; the rest comes below */
    for (int i = near_s; i <= s; i++) y->v[i] = x->v[i];
    y->v[near_t - t + t_new] = x->v[near_t];
    int ways = bidir_ways(y, s, t_new, m);
    if (ways == 0) return ZERO_NO_WAY;
    bool first = s < 1 || !material_is_specular(x->v[s].point.surface.material);
    int j = (int)rng_index(rng, (uint32_t)ways) + !first, joined = s + j;
    move->j = j;
    for (int i = s; i < joined; i++)
        if (!path_grow_to_lens(space, y, i, rng)) return ZERO_LOST;
    for (int i = t_new; i > joined + 1; i--)
        if (!path_grow_to_light(space, y, i, rng)) return ZERO_LOST;
    if (joined >= 0 && !path_edge(y, joined)) return ZERO_SIDE;
    for (int i = s < 0 ? 0 : s; i <= t_new && i <= y->k; i++)
        if (!path_scatter(space, y, i)) return i == y->k ? ZERO_FILM : ZERO_SIDE;
    memcpy(y->v, x->v, (size_t)near_s * sizeof y->v[0]);
    if (t < x->k) memcpy(y->v + t_new + 1, x->v + t + 1, (size_t)(x->k - t) * sizeof y->v[0]);
    path_finish(space, y);
    if (!(y->chi > 0)) return ZERO_CLASS;

    move->p_d1_x = bidir_p_d1(x->k, k_d);
    move->p_d2_x = bidir_p_d2(tuning, x, s, t);
    move->p_a1_x = bidir_p_a1(x->k, k_d, k_a, space->max_depth);
    move->p_a2_x = 1.0 / ways;
    move->routes_y = path_routes(y, s, t_new);
    move->p_d1_y = bidir_p_d1(y->k, k_a);
    move->p_d2_y = bidir_p_d2(tuning, y, s, t_new);
    move->p_a1_y = bidir_p_a1(y->k, k_a, k_d, space->max_depth);
    move->p_a2_y = 1.0 / ways_x;
    move->routes_x = path_routes(x, s, t);
    move->R_yx = y->chi / (move->p_d1_x * move->p_d2_x * move->p_a1_x * move->p_a2_x * move->routes_y);
    move->R_xy = x->chi / (move->p_d1_y * move->p_d2_y * move->p_a1_y * move->p_a2_y * move->routes_x);
    move->joined = joined;
    return PROPOSED;
}
