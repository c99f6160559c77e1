/* Draws the figures of doc/lecture.md as SVG:
 *
 *     cc doc/figures.c -o figures && ./figures doc/figures
 *
 * Rays are traced, not drawn by hand: mirrors reflect, water and glass obey Snell's law. Needs nothing but the C library, not even libm. */
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char INK[] = "#24292f", OLD[] = "#a0a7b0", FAINT[] = "#d5dae0", BLUE[] = "#1f6feb", ORANGE[] = "#c96a10", RED[] = "#c62f3f", GREEN[] = "#2b7a3f",
                  WATER[] = "#dcecfb", GLASS[] = "#e3f0ee", LAMP[] = "#f2b632", PAPER[] = "#ffffff";

typedef struct { double x, y; } P;

static FILE *out;

static P at(double x, double y) { return (P){ x, y }; }
static P plus(P a, double s, P b) { return at(a.x + s * b.x, a.y + s * b.y); }
static double root(double v)
{
    double r = v > 1 ? v : 1;
    for (int i = 0; i < 100; i++) r = 0.5 * (r + v / r);
    return r;
}
static P unit(P a) { double l = root(a.x * a.x + a.y * a.y); return at(a.x / l, a.y / l); }
static P from_to(P a, P b) { return unit(at(b.x - a.x, b.y - a.y)); }

/* ---- shapes ---- */

static void line(P a, P b, const char *colour, double width, const char *more)
{
    fprintf(out, "<line x1='%.1f' y1='%.1f' x2='%.1f' y2='%.1f' stroke='%s' stroke-width='%.1f' stroke-linecap='round' %s/>\n", a.x, a.y, b.x, b.y, colour, width, more);
}
static void dashed(P a, P b, const char *colour) { line(a, b, colour, 2.2, "stroke-dasharray='3 6'"); }
static void disk(P a, double r, const char *fill, const char *stroke)
{
    fprintf(out, "<circle cx='%.1f' cy='%.1f' r='%.1f' fill='%s' stroke='%s' stroke-width='1.5'/>\n", a.x, a.y, r, fill, stroke);
}
static void box(P a, double w, double h, const char *fill, const char *stroke, double round)
{
    fprintf(out, "<rect x='%.1f' y='%.1f' width='%.1f' height='%.1f' rx='%.1f' fill='%s' stroke='%s' stroke-width='1.2'/>\n", a.x, a.y, w, h, round, fill, stroke);
}
/* An arrow with its head 'share' of the way along. */
static void arrow(P a, P b, const char *colour, double width, double share)
{
    P w = from_to(a, b), tip = at(a.x + share * (b.x - a.x), a.y + share * (b.y - a.y)), n = at(-w.y, w.x), back = plus(tip, -10, w);
    bool to_end = share >= 1;
    line(a, to_end ? plus(tip, -6, w) : b, colour, width, "");
    P l = plus(back, 4.4, n), r = plus(back, -4.4, n);
    fprintf(out, "<path d='M%.1f %.1f L%.1f %.1f L%.1f %.1f Z' fill='%s'/>\n", tip.x, tip.y, l.x, l.y, r.x, r.y, colour);
}
/* _ and ^ lower and raise what follows: one character, or {several}. */
static void text(P a, const char *anchor, double size, const char *colour, const char *s)
{
    fprintf(out, "<text x='%.1f' y='%.1f' text-anchor='%s' font-size='%.1f' fill='%s' xml:space='preserve'>", a.x, a.y, anchor, size, colour);
    double shift = 0;                              /* a raised or lowered piece comes back with the next one */
    while (*s) {
        double want = *s == '_' ? 0.28 * size : *s == '^' ? -0.38 * size : 0;
        int n = want == 0 ? (int)strcspn(s, "_^") : 1;
        if (want != 0) {
            s++;
            if (*s == '{') { s++; n = (int)strcspn(s, "}"); }
            else while (((unsigned char)s[n] & 0xc0) == 0x80) n++;     /* the other bytes of one UTF-8 character */
        }
        fprintf(out, "<tspan dy='%.1f' font-size='%.1f'>", want - shift, want == 0 ? size : 0.72 * size);
        for (int i = 0; i < n; i++) {
            if (s[i] == '<') fputs("&lt;", out);
            else if (s[i] == '>') fputs("&gt;", out);
            else if (s[i] == '&') fputs("&amp;", out);
            else fputc(s[i], out);
        }
        fputs("</tspan>", out);
        shift = want;
        s += n;
        if (*s == '}') s++;
    }
    fputs("</text>\n", out);
}
static void heading(P a, const char *s)
{
    fputs("<g font-weight='bold'>", out);
    text(a, "start", 15, INK, s);
    fputs("</g>", out);
}
/* A piece of surface with its back hatched; 'in' points into it. */
static void surface(P a, P in, double half, const char *colour)
{
    in = unit(in);
    P t = at(-in.y, in.x), l = plus(a, -half, t), r = plus(a, half, t);
    for (double d = -half + 3; d <= half; d += 7) {
        P b = plus(a, d, t);
        line(b, plus(plus(b, 6, in), -4, t), colour, 1, "");
    }
    line(l, r, colour, 2, "");
}
static void lamp(P a)
{
    box(at(a.x - 20, a.y - 7), 40, 7, LAMP, LAMP, 2);
}
/* An eye at a, looking along w: two lids and the film before it. */
static void eye(P a, P w)
{
    P n = at(-w.y, w.x), f = plus(a, 16, w);
    line(plus(f, -11, n), plus(f, 11, n), INK, 2, "");
    line(a, plus(f, -11, n), INK, 1, "");
    line(a, plus(f, 11, n), INK, 1, "");
}
static void vertex(P a, const char *fill) { disk(a, 4.2, fill, PAPER); }

static void open_figure(const char *folder, const char *name, int width, int height, const char *title)
{
    char path[1024];
    if (snprintf(path, sizeof path, "%s/%s.svg", folder, name) >= (int)sizeof path || !(out = fopen(path, "w"))) {
        fprintf(stderr, "figures: cannot write %s/%s.svg\n", folder, name);
        exit(1);
    }
    fprintf(out, "<svg xmlns='http://www.w3.org/2000/svg' width='%d' height='%d' viewBox='0 0 %d %d' font-family='DejaVu Sans, Helvetica, Arial, sans-serif' role='img'>\n"
                 "<title>%s</title>\n<rect width='100%%' height='100%%' fill='%s'/>\n", width, height, width, height, title, PAPER);
}
static void close_figure(void)
{
    fputs("</svg>\n", out);
    if (ferror(out) || fclose(out) != 0) { fputs("figures: cannot write\n", stderr); exit(1); }
}

/* ---- optics ---- */

/* w refracted at a surface whose normal n points against it; eta = index before over index beyond */
static P refract(P w, P n, double eta)
{
    double c = -(w.x * n.x + w.y * n.y);
    return unit(plus(at(eta * w.x, eta * w.y), eta * c - root(1 - eta * eta * (1 - c * c)), n));
}
static P to_height(P a, P w, double y) { return plus(a, (y - a.y) / w.y, w); }
static P to_wall(P a, P w, double x) { return plus(a, (x - a.x) / w.x, w); }
static P to_circle(P a, P w, P centre, double r, bool far)
{
    P o = at(a.x - centre.x, a.y - centre.y);
    double b = o.x * w.x + o.y * w.y, d = root(b * b - o.x * o.x - o.y * o.y + r * r);
    return plus(a, far ? -b + d : -b - d, w);
}
/* w turned by a small angle given by its tangent */
static P turned(P w, double tangent) { return unit(plus(w, tangent, at(-w.y, w.x))); }

/* ---- the figures ---- */

static void figure_geometry(void)
{
    P a = at(130, 200), b = at(420, 90), w = from_to(a, b);
    fprintf(out, "<path d='M%.1f %.1f L%.1f %.1f L%.1f %.1f Z' fill='%s'/>\n", a.x, a.y, b.x - 17, b.y - 27, b.x + 17, b.y + 27, WATER);
    line(a, b, INK, 1.5, "");
    surface(a, at(0, 1), 55, INK);
    P tilt = unit(at(0.85, -0.53));
    P t = at(-tilt.y, tilt.x);
    surface(b, tilt, 62, INK);
    line(plus(b, -32, t), plus(b, 32, t), RED, 5, "");
    arrow(a, at(a.x, a.y - 95), BLUE, 2, 1);
    arrow(b, plus(b, -90, tilt), BLUE, 2, 1);
    text(at(a.x - 12, a.y - 86), "end", 14, BLUE, "n_a");
    text(at(b.x - 78, b.y + 66), "end", 14, BLUE, "n_b");
    text(at(a.x + 14, a.y - 30), "start", 14, INK, "θ_a");
    text(at(b.x - 64, b.y + 36), "start", 13, INK, "θ_b");
    text(at(b.x + 40, b.y + 6), "start", 14, RED, "dA(b)");
    vertex(a, INK);
    vertex(b, INK);
    text(at(a.x - 4, a.y + 26), "end", 15, INK, "a");
    text(at(b.x + 12, b.y - 14), "start", 15, INK, "b");
    text(at(a.x + 192, a.y - 57), "start", 12, INK, "dω");
    (void)w;
    text(at(560, 80), "start", 15, INK, "dω = cos θ_b dA(b) / |a − b|^2");
    text(at(560, 115), "start", 15, INK, "dσ^⊥ = cos θ_a dω = G(a,b) dA(b)");
    text(at(560, 160), "start", 13, INK, "A density per projected solid angle at a,");
    text(at(560, 180), "start", 13, INK, "times G, is a density per area at b.");
}

static P room_corner;
static P in_room(double x, double y) { return at(room_corner.x + x, room_corner.y + y); }
static void room(P corner, const char *title)
{
    room_corner = corner;
    heading(at(corner.x, corner.y - 14), title);
    box(corner, 240, 180, PAPER, FAINT, 0);
}

static void figure_deletion(void)
{
    P x0, x1, x2, x3, z;
    for (int i = 0; i < 3; i++) {
        static const char *const title[3] = { "x", "the deletion: s = 1, t = 2", "the addition: s' = 1, t' = 0" };
        room(at(20 + 280.0 * i, 40), title[i]);
        x0 = in_room(70, 7); x1 = in_room(0, 105); x2 = in_room(130, 180); x3 = in_room(228, 70); z = in_room(165, 0);
        lamp(at(x0.x, x0.y));
        surface(x1, at(-1, 0), 22, INK);
        surface(x2, at(0, 1), 22, INK);
        eye(x3, from_to(x3, x2));
        line(x0, x1, INK, 2, "");
        line(x2, x3, INK, 2, "");
        if (i == 0) line(x1, x2, INK, 2, "");
        else if (i == 1) dashed(x1, x2, OLD);
        else {
            surface(z, at(0, -1), 22, INK);
            arrow(x1, z, BLUE, 2, 0.55);
            dashed(z, x2, RED);
            text(at(z.x - 72, z.y + 72), "start", 13, BLUE, "sampled");
            text(at(z.x - 30, z.y + 132), "end", 13, RED, "joined");
            vertex(z, BLUE);
            text(at(z.x + 10, z.y + 20), "start", 15, BLUE, "z_0");
        }
        vertex(x0, INK); vertex(x1, INK); vertex(x2, INK); vertex(x3, INK);
        text(at(x0.x + 12, x0.y + 18), "start", 15, INK, "x_0");
        text(at(x1.x + 10, x1.y + 22), "start", 15, INK, "x_1");
        text(at(x2.x - 10, x2.y - 14), "end", 15, INK, "x_2");
        text(at(x3.x - 2, x3.y - 14), "middle", 15, INK, "x_3");
    }
}

static void figure_segments(void)
{
    enum { K = 3, CELL = 52 };
    P corner = at(96, 62);
    text(at(corner.x + 2.5 * CELL, 20), "middle", 14, INK, "s: the last vertex kept at the light");
    text(at(24, corner.y + 2.5 * CELL), "middle", 14, INK, "t");
    for (int s = -1; s <= K; s++) {
        char label[8];
        snprintf(label, sizeof label, s < 0 ? "−%d" : "%d", s < 0 ? -s : s);
        text(at(corner.x + (s + 1.5) * CELL, corner.y - 10), "middle", 14, INK, label);
        for (int t = 0; t <= K + 1; t++) {
            P cell = at(corner.x + (s + 1) * CELL, corner.y + t * CELL);
            if (s == -1) {
                snprintf(label, sizeof label, "%d", t);
                text(at(corner.x - 16, cell.y + CELL / 2 + 5), "middle", 14, INK, label);
            }
            if (t <= s) { box(cell, CELL, CELL, "#f4f5f7", FAINT, 0); continue; }
            bool whole = s == -1 && t == K + 1, none = s == K;
            const char *fill = none ? "#f9d9dc" : whole ? "#cfe8d3" : s == -1 ? "#fbe9c4" : t == K + 1 ? "#d9e7fb" : PAPER;
            box(cell, CELL, CELL, fill, OLD, 0);
            snprintf(label, sizeof label, "%d", t - s);
            text(at(cell.x + CELL / 2, cell.y + CELL / 2 + 6), "middle", none ? 13 : 17, INK, none ? "no way" : label);
        }
    }
    P key = at(400, 92);
    static const char *const name[5] = { "both ends stay: vertices between them are replaced", "s = −1: a new light end; x_t sees it, or hits it by chance",
                                         "t = k+1: a new lens end", "s = −1, t = k+1: a whole new path, independent of x", "s = k: nothing grows from the lens, no way to add" };
    static const char *const fill[5] = { "#ffffff", "#fbe9c4", "#d9e7fb", "#cfe8d3", "#f9d9dc" };
    text(at(key.x, key.y - 26), "start", 14, INK, "k = 3: x = x_0 x_1 x_2 x_3.  In a cell: k_d = t − s");
    for (int i = 0; i < 5; i++) {
        box(at(key.x, key.y + 36.0 * i), 24, 24, fill[i], OLD, 0);
        text(at(key.x + 36, key.y + 36.0 * i + 17), "start", 14, INK, name[i]);
    }
    text(at(key.x, key.y + 212), "start", 14, INK, "t: the first vertex kept at the lens");
}

static void figure_ways(void)
{
    static const char *const name[4] = { "x_1", "a", "b", "x_3" };
    static const char *const title[3] = { "j = 0:  (s', t') = (0, 2)", "j = 1:  (s', t') = (1, 1)", "j = 2:  (s', t') = (2, 0)" };
    static const char *const Q[3] = { "Q_0 = C(x_1,a) S^<(b) S^<(x_3)", "Q_1 = S^>(x_1) C(a,b) S^<(x_3)", "Q_2 = S^>(x_1) S^>(a) C(b,x_3)" };
    for (int j = 0; j < 3; j++) {
        double y = 40 + 128.0 * j;
        heading(at(20, y - 12), title[j]);
        P v[4];
        for (int i = 0; i < 4; i++) v[i] = at(60 + 130.0 * i, y + (i % 2 ? 16 : 66));
        dashed(plus(v[0], 42, from_to(v[0], at(v[0].x - 60, v[0].y - 34))), v[0], OLD);
        dashed(plus(v[3], 42, at(0.87, 0.5)), v[3], OLD);
        for (int i = 0; i < 3; i++) {
            P middle = at((v[i].x + v[i + 1].x) / 2, (v[i].y + v[i + 1].y) / 2);
            if (i < j) arrow(v[i], v[i + 1], BLUE, 2.4, 0.6);
            else if (i > j) arrow(v[i + 1], v[i], ORANGE, 2.4, 0.6);
            else dashed(v[i], v[i + 1], RED);
            text(at(middle.x + (i % 2 ? 8 : -6), middle.y - 10), i % 2 ? "start" : "end", 12, i < j ? BLUE : i > j ? ORANGE : RED, i < j ? "p^> G" : i > j ? "p^< G" : "joined");
        }
        for (int i = 0; i < 4; i++) {
            vertex(v[i], i == 0 || i == 3 ? INK : i <= j ? BLUE : ORANGE);
            text(at(v[i].x, v[i].y + (i % 2 ? -10 : 22)), "middle", 15, INK, name[i]);
        }
        text(at(560, y + 46), "start", 16, INK, Q[j]);
    }
    text(at(20, 424), "start", 12.5, INK, "The same y by three routes. Sampling leaves F/p = S, and the G cancels; the joined edge alone keeps F G F = C.");
}

static void ray(const P *v, int n, const char *colour, double width)
{
    for (int i = 0; i + 1 < n; i++) line(v[i], v[i + 1], colour, width, "");
}

static void panel(double x, const char *title, const char *suffix)
{
    room_corner = at(x, 66);
    heading(at(x, 24), title);
    text(at(x, 46), "start", 14, INK, suffix);
}

static void figure_perturbations(void)
{
    /* lens: eye, mirror, wall, lamp */
    panel(20, "lens", "(L|D) D S* E");
    P lens = in_room(12, 70), light = in_room(165, 7), v[6];
    box(in_room(0, 0), 240, 200, PAPER, FAINT, 0);
    lamp(light);
    line(in_room(60, 200), in_room(190, 200), BLUE, 3, "");
    text(in_room(125, 219), "middle", 12, BLUE, "mirror");
    eye(lens, from_to(lens, in_room(120, 200)));
    for (int i = 0; i < 2; i++) {
        P s = in_room(i ? 134 : 116, 200), w = from_to(lens, s), d = to_wall(s, at(w.x, -w.y), room_corner.x + 240);
        v[0] = lens; v[1] = s; v[2] = d;
        ray(v, 3, i ? BLUE : OLD, 2.4);
        dashed(d, light, i ? RED : OLD);
        surface(d, at(1, 0), 10, INK);
        vertex(s, i ? BLUE : OLD);
        vertex(d, i ? BLUE : OLD);
        if (i) { text(at(d.x - 8, d.y + 34), "end", 14, BLUE, "y_m"); text(at(s.x + 12, s.y - 6), "start", 14, BLUE, "S"); }
    }
    vertex(lens, INK);
    vertex(light, INK);
    text(at(light.x - 12, light.y + 20), "end", 14, INK, "x_{m−1}");
    text(at(lens.x + 2, lens.y - 14), "middle", 14, INK, "x_k");
    text(in_room(0, 242), "start", 12.5, INK, "a step on the film, S retraced,");
    text(in_room(0, 259), "start", 12.5, INK, "y_m joined to x_{m−1}");

    /* caustic: lamp, glass ball, floor, eye */
    panel(300, "caustic", "(L|D) S* D E");
    box(in_room(0, 0), 240, 200, PAPER, FAINT, 0);
    P centre = in_room(140, 88);
    light = in_room(120, 7);
    lens = in_room(14, 60);
    lamp(light);
    disk(centre, 42, GLASS, GREEN);
    eye(lens, from_to(lens, in_room(110, 200)));
    for (int i = 0; i < 2; i++) {
        P w = from_to(light, in_room(i ? 164 : 147, 60)), in = to_circle(light, w, centre, 42, false), n = from_to(centre, in);
        P inside = refract(w, n, 1 / 1.5), leave = to_circle(in, inside, centre, 42, true), m = from_to(leave, centre);
        P d = to_height(leave, refract(inside, m, 1.5), room_corner.y + 200);
        v[0] = light; v[1] = in; v[2] = leave; v[3] = d;
        ray(v, 4, i ? BLUE : OLD, 2.4);
        dashed(d, lens, i ? RED : OLD);
        surface(d, at(0, 1), 10, INK);
        for (int j = 1; j < 4; j++) vertex(v[j], i ? BLUE : OLD);
        if (i) text(at(d.x + 22, d.y - 8), "start", 14, BLUE, "y_{k−1}");
    }
    vertex(lens, INK);
    vertex(light, INK);
    text(at(light.x - 24, light.y + 16), "end", 14, INK, "x_m");
    text(at(lens.x + 6, lens.y - 12), "middle", 14, INK, "x_k");
    text(in_room(122, 96), "middle", 14, GREEN, "S S");
    text(in_room(0, 242), "start", 12.5, INK, "the direction at x_m turned, S retraced,");
    text(in_room(0, 259), "start", 12.5, INK, "y_{k−1} joined to the lens");

    /* chain: eye, water, floor, water, wall, lamp */
    panel(580, "multi-chain", "(L|D) D (S+ D)+ S* E");
    box(in_room(0, 0), 240, 200, PAPER, FAINT, 0);
    box(in_room(0, 110), 240, 90, WATER, WATER, 0);
    line(in_room(0, 110), in_room(240, 110), BLUE, 1.5, "");
    lens = in_room(14, 24);
    light = in_room(120, 7);
    lamp(light);
    P up = { 0, 0 };
    eye(lens, from_to(lens, in_room(52, 110)));
    for (int i = 0; i < 2; i++) {
        P s = in_room(i ? 56 : 42, 110), w = from_to(lens, s), d = to_height(s, refract(w, at(0, -1), 1 / 1.33), room_corner.y + 200);
        up = i ? turned(up, -0.07) : from_to(d, in_room(150, 110));
        P s2 = to_height(d, up, room_corner.y + 110), wall = to_wall(s2, refract(up, at(0, 1), 1.33), room_corner.x + 240);
        v[0] = lens; v[1] = s; v[2] = d; v[3] = s2; v[4] = wall;
        ray(v, 5, i ? BLUE : OLD, 2.4);
        dashed(wall, light, i ? RED : OLD);
        surface(d, at(0, 1), 10, INK);
        surface(wall, at(1, 0), 10, INK);
        for (int j = 1; j < 5; j++) vertex(v[j], i ? BLUE : OLD);
        if (i) {
            text(at(d.x + 34, d.y - 7), "start", 14, BLUE, "D, turned");
            text(at(wall.x - 10, wall.y + 30), "end", 14, BLUE, "y_m");
            text(at(s.x + 8, s.y - 8), "start", 14, BLUE, "S");
            text(at(s2.x - 8, s2.y - 8), "end", 14, BLUE, "S");
        }
    }
    vertex(lens, INK);
    vertex(light, INK);
    text(at(light.x - 10, light.y + 20), "end", 14, INK, "x_{m−1}");
    text(at(lens.x + 20, lens.y - 6), "start", 14, INK, "x_k");
    text(in_room(0, 242), "start", 12.5, INK, "a step on the film, S retraced, at each D the");
    text(in_room(0, 259), "start", 12.5, INK, "old direction turned, y_m joined to x_{m−1}");
}

static void curve(P a, P b, double bend, const char *colour, double width, bool reverse)
{
    P middle = at((a.x + b.x) / 2, (a.y + b.y) / 2 + bend);
    P tip = reverse ? a : b, w = from_to(middle, tip), n = at(-w.y, w.x), stop = plus(tip, -8, w);
    fprintf(out, "<path d='M%.1f %.1f Q%.1f %.1f %.1f %.1f' fill='none' stroke='%s' stroke-width='%.1f'/>\n", reverse ? stop.x : a.x, reverse ? stop.y : a.y, middle.x, middle.y,
            reverse ? b.x : stop.x, reverse ? b.y : stop.y, colour, width);
    P back = plus(tip, -13, w), l = plus(back, 4 + width, n), r = plus(back, -4 - width, n);
    fprintf(out, "<path d='M%.1f %.1f L%.1f %.1f L%.1f %.1f Z' fill='%s'/>\n", tip.x, tip.y, l.x, l.y, r.x, r.y, colour);
}

static void figure_balance(void)
{
    static const char *const name[3] = { "f(x) T_1(y|x) a_1(y|x)  =  f(y) T_1(x|y) a_1(x|y)", "f(x) T_2(y|x) a_2(y|x)  =  f(y) T_2(x|y) a_2(x|y)",
                                         "f(x) T_3(y|x) a_3(y|x)  =  f(y) T_3(x|y) a_3(x|y)" };
    static const char *colour[3];
    colour[0] = BLUE; colour[1] = GREEN; colour[2] = ORANGE;
    for (int i = 0; i < 3; i++) {
        double y = 74 + 82.0 * i, width = i == 0 ? 1.5 : i == 1 ? 5 : 3;
        curve(at(112, y), at(588, y), -26, colour[i], width, false);
        curve(at(112, y + 12), at(588, y + 12), 26, colour[i], width, true);
        text(at(350, y + 11), "middle", 15, INK, name[i]);
    }
    box(at(30, 40), 72, 250, "#f4f5f7", OLD, 10);
    box(at(598, 40), 72, 250, "#f4f5f7", OLD, 10);
    text(at(66, 172), "middle", 26, INK, "x");
    text(at(634, 172), "middle", 26, INK, "y");
    text(at(350, 322), "middle", 14, INK, "Each strategy carries as much there as back, so all of them together do.");
}

static void figure_rounds(void)
{
    static const double weight[14] = { 0, 18, 6, 0, 46, 11, 0, 3, 72, 9, 0, 26, 14, 5 };
    heading(at(20, 26), "bootstrap: n samples");
    heading(at(330, 26), "chains");
    heading(at(640, 26), "picture");
    for (int round = 0; round < 2; round++) {
        double y = 130 + 150.0 * round, sum = 0;
        for (int i = 0; i < 14; i++) {
            double w = weight[(i + 5 * round) % 14] * (round ? 0.85 : 1);
            sum += w;
            box(at(24 + 18.0 * i, y - w), 11, w, w > 40 ? BLUE : "#bcd3f7", w > 40 ? BLUE : "#bcd3f7", 0);
        }
        line(at(20, y), at(276, y), INK, 1.2, "");
        double mean = y - sum / 14;
        line(at(20, mean), at(280, mean), RED, 1.6, "stroke-dasharray='6 4'");
        text(at(286, mean + 5), "start", 14, RED, round ? "b_2" : "b_1");
        text(at(24, y + 19), "start", 12.5, INK, "W_i;  seeds drawn in proportion to W_i");
        for (int c = 0; c < 3; c++) {
            P a = at(336, y - 66 + 30.0 * c);
            disk(a, 5, BLUE, PAPER);
            for (int i = 0; i < 12; i++) {
                unsigned bits = (unsigned)(i * 7919 + c * 104729 + round * 1299709 + 12345);
                bits = bits * 1103515245u + 12345u;
                P b = at(a.x + 19, y - 66 + 30.0 * c + (double)(bits >> 16 & 15) - 7.5);
                line(a, b, BLUE, 1.6, "");
                disk(b, 2.2, BLUE, BLUE);
                a = b;
            }
        }
        arrow(at(585, y - 36), at(632, y - 36), INK, 1.8, 1);
        text(at(608, y - 46), "middle", 13, RED, round ? "× b_2" : "× b_1");
        box(at(640, y - 76), 96, 78, round ? "#e8eef8" : "#e4ecf9", OLD, 3);
        text(at(688, y - 31), "middle", 14, INK, round ? "I_2" : "I_1");
        line(at(740, y - 37), at(768, 168), INK, 1.8, "");
    }
    text(at(776, 165), "start", 14, INK, "average,");
    text(at(776, 184), "start", 14, INK, "by steps");
}

int main(int argc, char **argv)
{
    static const struct { const char *name, *title; int width, height; void (*draw)(void); } figure[] = {
        { "geometry", "From solid angle to area: the factor G", 860, 250, figure_geometry },
        { "balance", "Detailed balance, strategy by strategy", 700, 340, figure_balance },
        { "deletion", "A bidirectional mutation: deletion and addition", 860, 250, figure_deletion },
        { "segments", "Which s and t are possible", 860, 336, figure_segments },
        { "ways", "The three ways to make the same path", 860, 440, figure_ways },
        { "perturbations", "Lens, caustic and multi-chain perturbation", 860, 340, figure_perturbations },
        { "rounds", "Bootstrap, chains and rounds", 860, 310, figure_rounds },
    };
    if (argc != 2) {
        fputs("usage: figures FOLDER\n", stderr);
        return 2;
    }
    for (size_t i = 0; i < sizeof figure / sizeof *figure; i++) {
        open_figure(argv[1], figure[i].name, figure[i].width, figure[i].height, figure[i].title);
        figure[i].draw();
        close_figure();
    }
    return 0;
}
