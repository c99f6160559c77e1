/* Mutations: one row of a table each. The chain (mlt.c) walks the table and knows no mutation by name; tests pass faulty rows.
 *
 * A row proposes y from x and says R(y|x) and R(x|y), R = f/T up to what both share [lecture: AcceptProb]. Each row is in detailed balance
 * by itself, so any choice among rows that apply is right as long as the choice's own probabilities enter the ratio (mlt.c does that).
 * Knows no chain, no image. */
#ifndef MUTATE_H
#define MUTATE_H
#include "path.h"

/* Constants that are fixed before a chain runs. */
typedef struct {
    double p_d2_importance;    /* share of the lecture's p_d2 in the choice of the segment to delete; the rest is uniform */
    double light_scale;        /* factor on w[-1,t], which carries L_e or p_A where the others carry F G F */
    double r2, log_r;          /* pixels: steps on the film lie in [r1, r2], log_r = ln(r1/r2) */
    double theta2, log_theta;  /* radians: turned directions, in [theta1, theta2] likewise */
} Tuning;

/* Why nothing was proposed, or that something was. Visibility comes last and is the chain's to test: BLOCKED is its word. */
typedef enum {
    PROPOSED,
    ZERO_NO_WAY,               /* no way to add these vertices, or none back */
    ZERO_LOST,                 /* a ray met nothing, or a sample fell below its surface */
    ZERO_SIDE,                 /* nothing is scattered or emitted that way, or a specular vertex is where none may be */
    ZERO_FILM,                 /* off the film */
    ZERO_CLASS,                /* not in the space: too long, direct light, black */
    ZERO_BLOCKED,              /* the joined edge is not visible */
    OUTCOMES
} Outcome;
extern const char *const outcome_name[OUTCOMES];

/* What a row did. The first three are all that the chain reads; the others are for 'explain' and tests. */
typedef struct {
    double R_yx, R_xy;         /* R(y|x), R(x|y) */
    int joined;                /* y's edge from v[joined] whose visibility is still open; -1 if there is none */
    /* bidirectional: x_s .. x_t were cut apart, k_d edges deleted, k_a added, j vertices grown from x_s */
    int s, t, k_d, k_a, j;
    double p_d1_x, p_d2_x, p_a1_x, p_a2_x, routes_y;   /* forward: T(y|x)/f(y) = p_d1 p_d2 p_a1 p_a2 routes / chi */
    double p_d1_y, p_d2_y, p_a1_y, p_a2_y, routes_x;   /* and back */
    /* the other rows: x_first .. x_last were moved */
    int first, last;
    double spread_x, spread_y; /* manifold: manifold_spread */
} Move;

/* The constant that scales a row's steps, so that a pilot can tune it by how many of them are accepted. */
typedef enum { STEP_NONE, STEP_FILM, STEP_TURN } StepKind;

typedef struct {
    const char *name;
    double share;              /* how often the row is chosen, against the others that apply */
    bool needs_sharp;          /* only of use in a scene with specular surfaces or narrow lobes */
    /* Whether the row can start from x. Needs only the roles, modes and narrow lobes along the path. */
    bool (*applies)(const Space *space, const Path *x);
    /* Proposes. y need not be complete unless PROPOSED comes back. */
    Outcome (*propose)(const Space *space, const Tuning *tuning, const Path *x, Path *y, Rng *rng, Move *move);
    StepKind step;
} Mutation;

static inline bool mutation_is_useful(const Mutation *m, const Scene *scene) { return !m->needs_sharp || scene->has_specular || scene->has_narrow; }

/* A lens perturbation for L S+ E, the whole path: not in the table, for no chain of a bootstrap has such paths to itself. */
extern const Mutation seen_mutation;
enum { MUTATIONS = 6 };
extern const Mutation mutation_table[MUTATIONS];   /* bidir, lens, caustic, chain, subpath, manifold */

/* The parts of the bidirectional mutation's T, also for tests and 'explain'. */
double bidir_p_d1(int k, int k_d);                          /* 1 <= k_d <= k+2 */
double bidir_p_a1(int k, int k_d, int k_a, int max_depth);  /* 0 where k_a cannot be */
/* Number of possible j when m vertices go between z_s and z_t of a path of z->k edges in which they stand (the new one). */
int bidir_ways(const Path *z, int s, int t, int m);
/* w[s,t]: sum over the ways j to regrow the segment of p_a2[j] / Q_j. */
double bidir_w(const Path *z, int s, int t);
/* p_d2[s,t] */
double bidir_p_d2(const Tuning *tuning, const Path *z, int s, int t);

/* Read from the light: L light, D a vertex that is not sharp (path_sharp), S a sharp one, E lens. What a perturbation moves is x_m .. x_{k-1}; -1 where the
 * suffix is another. */
/* The lens perturbation: suffix D S* E with x_m = D, joined to what is not specular. */
int lens_suffix(const Path *x);
/* The multi-chain perturbation: (L|D) D (S+ D)+ S* E with x_m the first D after the parenthesis, or L (S+ D)* S* E with m = 0, but that a chain of
 * mirrors and glass alone, L S+ E, is no such; *turned receives the number of (S+ D). */
int chain_suffix(const Path *x, int *turned);
/* The vertex whose direction a caustic perturbation turns: suffix (L|D) S* D E with x_m = (L|D); x_m itself does not move. */
int caustic_suffix(const Path *x);
/* R(y|x) of a perturbation that moved x_m .. x_{k-1} and copied how light passes sharp vertices: chi(y) * product of S< over specular vertices, of
 * F |cos| over the others, * C_{m-1}. */
double lens_R(const Path *y, int m);
/* R(y|x) of a caustic perturbation: chi(y) * F_m |cos_m| * product of S> over specular vertices, of F |cos| over narrow lobes, * C_{k-1}. */
double caustic_R(const Path *y, int m);

bool bidir_applies(const Space *space, const Path *x);
Outcome bidir_propose(const Space *space, const Tuning *tuning, const Path *x, Path *y, Rng *rng, Move *move);

/* Steps of perturbations, for manifold.c too. Moves x_{m+1} .. x_{k-1}, starting on the film, sharp vertices copied and directions turned, and sets y_m. */
Outcome perturb_walk(const Space *space, const Tuning *tuning, const Path *x, Path *y, int m, Rng *rng);
/* What follows when all points stand: evaluates y_from .. y_to; the edge to v[joined + 1] is still open. */
Outcome perturb_evaluate(const Space *space, Path *y, int from, int to, int joined);
/* Whether light passes narrow lobes at the same vertices from x_i on, so that what may go from x to y may go back. */
bool perturb_alike(const Path *x, const Path *y, int from);

bool manifold_applies(const Space *space, const Path *x);
Outcome manifold_propose(const Space *space, const Tuning *tuning, const Path *x, Path *y, Rng *rng, Move *move);
/* The D next to the light of a path L S+ D (S+ D)* S+ E; 0 if it is another, or has a great many specular vertices there. */
int manifold_diffuse(const Path *x);
/* Of such a path: solid angle at that D over area at x_0, through the sharp vertices between, |dw/dx_0|; with none it would be cos/r^2. 'like' is the path
 * whose narrow lobes are copied. */
double manifold_spread(const Scene *scene, const Path *x, const Path *like);
#endif
