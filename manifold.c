/* The manifold perturbation: L S+ D (S+ D)* S* E moved on the film, while the point of the lamp stays. [Jakob and Marschner 2012: manifold exploration]
 *
 * Between D and the light such a path cannot be joined. The multi-chain perturbation turns the direction at the D next to the light and hopes to meet the lamp
 * again; if that is small, it seldom does. Here the direction is searched for: Newton's method, on the ray that leaves D, passes the specular vertices by
 * the copied modes and ought to arrive at x_0. In T(y|x) stand the step on the film, which is symmetric, and for the D a density that is constant over the
 * area of the lamp, which is |dx_0/dw| per solid angle:
 *
 *     R(y|x) = chi(y) * product of S< * F |cos| at every D * |dw/dx_0| at the last * L_e          (without specular vertices: F G L_e, the join)
 *
 * From y the search has to find the way back to what it finds at x, or there is no such step.
 */
#include "mutate.h"
#include "specular.h"

/* Scene units. So near are vertices the same if only one was found and the other is of a path: rays start a little beside their surface (scene.h), so a path
 * that was grown from the light is not quite the one that is found. */
static const double ALIKE = 1e-3;

int manifold_diffuse(const Path *x)
{
    int turned, d = 1;
    if (chain_suffix(x, &turned) != 0 || turned == 0) return 0;
    while (path_sharp(x, d)) d++;
    return d - 1 <= MOST_SPECULAR ? d : 0;
}

bool manifold_applies(const Space *space, const Path *x) { (void)space; return manifold_diffuse(x) > 0; }

/* How light passes the vertices between D and the lamp. */
static void passages(const Path *x, int d, Passage passage[])
{
    for (int i = 1; i < d; i++) passage[i] = path_passage(x, i, true);
}

double manifold_spread(const Scene *scene, const Path *x, const Path *like)
{
    Passage passage[MOST_SPECULAR + 2];
    int d = manifold_diffuse(x);
    passages(like, d, passage);
    return specular_spread(scene, passage, x->v, d);
}

/* From v[d], as light passes 'like' and towards where it goes, to its point of the lamp. */
static bool search(const Scene *scene, const Path *like, Vertex *v, int d)
{
    Passage passage[MOST_SPECULAR + 2];
    passages(like, d, passage);
    return specular_search(scene, passage, v, d, normalize(sub(like->v[d - 1].point.p, v[d].point.p)), &like->v[0].point);
}

/* What is found at x_d itself, or there again from y. */
static bool search_at(const Scene *scene, const Path *x, const Path *like, Vertex *v, int d)
{
    v[d] = x->v[d];
    return search(scene, like, v, d);
}

Outcome manifold_propose(const Space *space, const Tuning *tuning, const Path *x, Path *y, Rng *rng, Move *move)
{
    const Scene *scene = space->scene;
    Vertex found[MOST_SPECULAR + 2], back[MOST_SPECULAR + 2];
    int d = manifold_diffuse(x);
    Outcome outcome = perturb_walk(space, tuning, x, y, d, rng);
    if (outcome != PROPOSED) return outcome;
    if (material_is_specular(y->v[d].point.surface.material)) return ZERO_SIDE;
    y->v[d].mode = MODE_NONE;
    if (!search(scene, x, y->v, d)) return ZERO_LOST;
    for (int i = d - 1; i >= 0; i--)
        if (!path_edge(y, i)) return ZERO_LOST;
    outcome = perturb_evaluate(space, y, 0, y->k, -1);
    if (outcome != PROPOSED) return outcome;
    if (!perturb_alike(x, y, 1)) return ZERO_SIDE;
    if (!search_at(scene, x, x, found, d) || !specular_near(found, x->v, d, ALIKE) || !search_at(scene, x, y, back, d) || !specular_near(found, back, d, SPECULAR_SAME)) return ZERO_NO_WAY;
    *move = (Move){ .joined = -1, .first = 0, .last = x->k - 1, .spread_x = manifold_spread(scene, x, y), .spread_y = manifold_spread(scene, y, x) };
    move->R_yx = lens_R(y, 0) * move->spread_y;
    move->R_xy = lens_R(x, 0) * move->spread_x;
    return isfinite(move->R_yx) && isfinite(move->R_xy) ? PROPOSED : ZERO_NO_WAY;     /* all directions lead to one place: a focus */
}
