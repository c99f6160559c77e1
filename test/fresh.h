/* Whether what a path has cached is what path_evaluate makes of its points and modes. */
#ifndef FRESH_H
#define FRESH_H
#include "check.h"
#include "mutate.h"

static inline void fresh_worse(double *worst, double a, double b)
{
    check_worse(worst, a == b ? 0 : fabs(a - b) / fmax(fabs(a), fabs(b)));
}

static inline void fresh_apart(double *worst, Vec3 a, Vec3 b) { check_worse(worst, length(sub(a, b))); }

/* The largest relative difference of any cached number of x from the same made anew in 'work'; infinite if x is not a path any more. */
static inline double fresh_difference(const Space *space, const Path *x, Path *work)
{
    double worst = 0;
    path_copy(work, x);
    work->raster_x = work->raster_y = work->light_pdf_a = work->share = work->chi = NAN;
    work->colour = vec3(NAN, NAN, NAN);
    work->pixel = UINT32_MAX;
    work->known.d = 0;
    for (int i = 0; i <= x->k; i++) {
        work->v[i].s = (Scatter){ { NAN, NAN, NAN }, NAN, NAN, NAN, NAN, !x->v[i].s.narrow };
        work->v[i].to_lens = vec3(NAN, NAN, NAN);
        work->v[i].inv_G = NAN;
    }
    if (!path_evaluate(space, work) || work->pixel != x->pixel) return INFINITY;
    fresh_worse(&worst, work->chi, x->chi);
    fresh_worse(&worst, work->share, x->share);
    fresh_worse(&worst, work->light_pdf_a, x->light_pdf_a);
    fresh_worse(&worst, work->raster_x, x->raster_x);
    fresh_worse(&worst, work->raster_y, x->raster_y);
    fresh_apart(&worst, work->colour, x->colour);
    for (int i = 0; i <= x->k; i++) {
        const Vertex *a = &work->v[i], *b = &x->v[i];
        if (i > 0) fresh_worse(&worst, a->s.inv_S_light, b->s.inv_S_light);
        if (i < x->k) fresh_worse(&worst, a->s.inv_S_lens, b->s.inv_S_lens);
        fresh_worse(&worst, a->s.inv_F, b->s.inv_F);
        if (i > 0 && i < x->k) fresh_worse(&worst, a->s.q, b->s.q);
        if (a->s.narrow != b->s.narrow) return INFINITY;
        fresh_apart(&worst, a->s.colour, b->s.colour);
        if (i == x->k) break;
        fresh_worse(&worst, a->inv_G, b->inv_G);
        fresh_apart(&worst, a->to_lens, b->to_lens);
    }
    return worst;
}
#endif
