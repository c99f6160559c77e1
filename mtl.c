/* The reader of MTL files, and of SCENE.cam, which is as simple a list of keywords.
 *
 * Source: Wavefront's MTL as its specification and the common exporters have it. Where they leave a choice:
 *   - keywords count in any case; the first definition of a name counts;
 *   - Kd 0.6 where none is given, Ns 0, Ni 1.5, Tf 1; Ks 0, but 1 for a mirror;
 *   - a number that is missing in 'Kd r' repeats the last one; one that is no number is 0, with a warning; nothing in an MTL file is an error;
 *   - a texture that can be read replaces Kd; it is looked up at s * uv + o, as exporters write -s and -o;
 *   - Kd + Ks above 1 in a channel, or the texture's largest value + Ks, is scaled to 1 in that channel.
 * Must not know the mesh. */
#include "mtl.h"
#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

typedef struct {
    MtlLibrary *library;
    MtlEntry *entry;                   /* the material that the statements are about, NULL = none */
    bool skip;                         /* whether statements that are about none pass in silence, as a newmtl has said why */
    Notes *notes;
    Text text;
} Mtl;

static void warn(Mtl *m, const char *kind) { note(m->notes, m->text.path, m->text.line, kind); }

static void warn_token(Mtl *m, const char *kind, const char *token, size_t n)
{
    note_name(m->notes, m->text.path, m->text.line, kind, token, n);
}

static bool is_word(const char *token, size_t n, const char *word)
{
    return strlen(word) == n && strncasecmp(token, word, n) == 0;
}

static double clamp(Mtl *m, double x, double low, double high)
{
    if (x < low || x > high) warn(m, "a value is out of its range and is clamped");
    return fmin(fmax(x, low), high);
}

/* Up to 'most' numbers from p on; one that is none counts as 0. */
static int read_numbers(Mtl *m, char *p, double *value, int most)
{
    int n = 0;
    for (; n < most; n++) {
        p = skip_blanks(p);
        if (is_stop(*p)) break;
        char *end = skip_token(p), *q = number_scan(p, &value[n]);
        if (q != end) {
            warn_token(m, "not a number, taken as 0:", p, (size_t)(end - p));
            value[n] = 0;
        }
        if (end == p) break;           /* a backslash in the middle of nowhere */
        p = end;
    }
    if (n == 0) warn(m, "a statement without its value");
    return n;
}

static void read_number(Mtl *m, char *p, double *value, double low, double high)
{
    double v;
    if (read_numbers(m, p, &v, 1) == 1) *value = clamp(m, v, low, high);
}

/* r [g b] or xyz x [y z]; 'spectral FILE' is left at the default. */
static void read_colour(Mtl *m, char *p, Rgb *colour, double high)
{
    char *end = skip_token(p);
    bool xyz = is_word(p, (size_t)(end - p), "xyz");
    if (is_word(p, (size_t)(end - p), "spectral")) {
        warn(m, "spectral curves are not supported");
        return;
    }
    double v[3];
    int n = read_numbers(m, xyz ? end : p, v, 3);
    if (n == 0) return;
    for (; n < 3; n++) v[n] = v[n - 1];
    Rgb c = vec3(v[0], v[1], v[2]);
    if (xyz) {                         /* CIE XYZ to Rec. 709; what lies outside is cut */
        c = vec3(fmax(0, 3.2404542 * v[0] - 1.5371385 * v[1] - 0.4985314 * v[2]),
                 fmax(0, -0.9692660 * v[0] + 1.8760108 * v[1] + 0.0415560 * v[2]),
                 fmax(0, 0.0556434 * v[0] - 0.2040259 * v[1] + 1.0572252 * v[2]));
    }
    *colour = vec3(clamp(m, c.x, 0, high), clamp(m, c.y, 0, high), clamp(m, c.z, 0, high));
}

static bool is_number(char *p, char *end)
{
    double value;
    return number_scan(p, &value) == end;
}

/* -s and -o for u and v; a third number, for solid textures, is of no use here. What is not given stays. */
static void read_place(Mtl *m, const char *option, char *const token[3], int n, double place[2])
{
    for (int k = 0; k < n && k < 2; k++) {
        double v;
        if (is_number(token[k], skip_token(token[k])) && number_scan(token[k], &v)) place[k] = clamp(m, v, -1e30, 1e30);
        else warn_token(m, "texture option that cannot be read:", option, strlen(option));
    }
}

/* Reads the options before a texture's name and returns where they end. */
static char *read_options(Mtl *m, char *p, MapPlace *place)
{
    static const struct { const char *name; int least, most; } options[] = {
        { "-blendu", 1, 1 }, { "-blendv", 1, 1 }, { "-boost", 1, 1 }, { "-bm", 1, 1 }, { "-cc", 1, 1 }, { "-clamp", 1, 1 },
        { "-colorspace", 1, 1 }, { "-imfchan", 1, 1 }, { "-mm", 2, 2 }, { "-o", 1, 3 }, { "-s", 1, 3 }, { "-t", 1, 3 },
        { "-texres", 1, 1 }, { "-type", 1, 1 }
    };
    while (*p == '-') {
        char *word = p, *end = skip_token(p), *token[3];
        size_t length = (size_t)(end - p);
        int least = 0, most = 0, n = 0;
        for (size_t i = 0; i < sizeof options / sizeof options[0]; i++)
            if (is_word(p, length, options[i].name)) {
                least = options[i].least;
                most = options[i].most;
            }
        p = skip_blanks(end);
        while (n < most && !is_line_end(*p)) {
            end = skip_token(p);
            if (n >= least && !is_number(p, end)) break;
            if (end == p) break;
            token[n++] = p;
            p = skip_blanks(end);
        }
        if (is_word(word, length, "-s")) read_place(m, "-s", token, n, place->scale);
        else if (is_word(word, length, "-o")) read_place(m, "-o", token, n, place->offset);
        else if (is_word(word, length, "-clamp")) place->clamp = n > 0 && is_word(token[0], (size_t)(skip_token(token[0]) - token[0]), "on");
        else warn_token(m, most ? "texture option without effect:" : "unknown texture option", word, length);
    }
    return p;
}

static char *base_name(char *p, size_t *n)
{
    for (size_t i = *n; i > 0; i--)
        if (p[i - 1] == '/' || p[i - 1] == '\\') {
            *n -= i;
            return p + i;
        }
    return p;
}

/* False only if memory runs out. */
static bool read_map(Mtl *m, char *p)
{
    const char *from = m->text.path;
    MtlEntry *e = m->entry;
    MapPlace place = { { 1, 1 }, { 0, 0 }, false };
    p = read_options(m, p, &place);
    size_t n = rest_of_line(p);
    if (n == 0) {
        warn(m, "map_Kd without a file");
        return true;
    }
    char *path = text_find_file(from, p, n);
    if (!path) {                       /* options behind the name; a name behind what an unknown option may have taken */
        size_t cut = 1;
        while (cut < n && !(is_blank(p[cut - 1]) && p[cut] == '-')) cut++;
        size_t last = n;
        while (last > 0 && !is_blank(p[last - 1])) last--;
        if (cut < n) {
            size_t k = cut;
            while (k > 0 && is_blank(p[k - 1])) k--;
            path = text_find_file(from, p, k);
        }
        if (!path && last > 0) path = text_find_file(from, p + last, n - last);
        if (path) warn(m, "map_Kd: only part of the line is the name of a file");
    }
    if (!path) {                       /* a path of the machine where the file was made */
        size_t k = n;
        char *base = base_name(p, &k);
        if (base != p) path = text_find_file(from, base, k);
    }
    e->map_found = path != NULL;
    e->map_place = place;
    if (!path && (path = malloc(n + 1))) {
        memcpy(path, p, n);
        path[n] = 0;
    }
    if (!path) return false;
    free(e->map_kd);
    e->map_kd = path;
    e->map_line = m->text.line;
    return true;
}

static bool new_material(Mtl *m, char *p)
{
    MtlLibrary *library = m->library;
    size_t n = rest_of_line(p);
    m->entry = NULL;
    m->skip = true;
    if (n == 0) {
        warn(m, "newmtl without a name");
        return true;
    }
    uint32_t count = library->names.n;
    if (!array_grow(&library->entry, count, &library->entry_capacity, sizeof *library->entry, 0)) return false;
    uint32_t i = names_add(&library->names, p, n);
    if (i == BVH_NONE) return false;
    if (i < count) {
        if (library->entry[i].file + 1 == library->files.n) warn_token(m, "material defined again, the first definition counts:", p, n);
        return true;
    }
    Rgb none = vec3(NAN, NAN, NAN);
    m->entry = &library->entry[i];
    *m->entry = (MtlEntry){ .file = library->files.n - 1, .line = m->text.line, .kd = none, .ks = none, .tf = none, .ke = none,
                            .ns = NAN, .ni = NAN, .d = NAN, .tr = NAN, .illum = -1 };
    return true;
}

/* What does not change the picture, or would if the renderer had it. */
static void other_statement(Mtl *m, const char *word, size_t n)
{
    static const char *const harmless[] = { "Ka", "map_Ka", "sharpness", "map_aat" };
    static const char *const missing[] = {
        "map_Ks", "map_Ke", "map_Ns", "map_d", "map_Tr", "map_opacity", "map_bump", "bump", "norm", "map_Kn", "disp", "map_disp", "decal", "refl",
        "map_refl", "Pr", "Pm", "Ps", "Pc", "Pcr", "aniso", "anisor", "map_Pr", "map_Pm", "map_Ps", "map_Pc", "map_Pcr", "map_RMA", "map_ORM"
    };
    for (size_t i = 0; i < sizeof harmless / sizeof harmless[0]; i++)
        if (is_word(word, n, harmless[i])) return;
    for (size_t i = 0; i < sizeof missing / sizeof missing[0]; i++)
        if (is_word(word, n, missing[i])) {
            warn_token(m, "not supported and ignored:", word, n);
            return;
        }
    warn_token(m, "unknown statement", word, n);
}

static const double colour_high = 1e30, ns_high = 1e8, ni_low = 0.001, ni_high = 10;

/* False only if memory runs out. */
static bool statement(Mtl *m, char *p)
{
    char *word = p;
    size_t n = (size_t)(skip_token(p) - p);
    p = skip_blanks(p + n);
    if (is_word(word, n, "newmtl")) return new_material(m, p);
    MtlEntry *e = m->entry;
    if (!e && m->skip) return true;
    if (!e) warn(m, "statements that belong to no material");
    else if (is_word(word, n, "Kd")) read_colour(m, p, &e->kd, colour_high);
    else if (is_word(word, n, "Ks")) read_colour(m, p, &e->ks, colour_high);
    else if (is_word(word, n, "Ke")) read_colour(m, p, &e->ke, colour_high);
    else if (is_word(word, n, "Tf") || is_word(word, n, "Kt")) read_colour(m, p, &e->tf, colour_high);
    else if (is_word(word, n, "Ns")) read_number(m, p, &e->ns, 0, ns_high);
    else if (is_word(word, n, "Ni")) read_number(m, p, &e->ni, ni_low, ni_high);
    else if (is_word(word, n, "d")) {
        if (is_word(p, (size_t)(skip_token(p) - p), "-halo")) p += 5;
        read_number(m, p, &e->d, 0, 1);
    } else if (is_word(word, n, "Tr")) read_number(m, p, &e->tr, 0, 1);
    else if (is_word(word, n, "illum")) {
        double v;
        if (read_numbers(m, p, &v, 1) == 1) {
            bool known = v >= 0 && v <= 10 && v == floor(v) && is_number(p, skip_token(p));
            if (!known) warn(m, "unknown illum, taken as 2");
            e->illum = known ? (int)v : 2;
        }
    } else if (is_word(word, n, "map_Kd")) return read_map(m, p);
    else other_statement(m, word, n);
    return true;
}

bool mtl_read(MtlLibrary *library, const char *path, Notes *notes)
{
    uint32_t count = library->files.n, file = names_add(&library->files, path, strlen(path));
    if (file == BVH_NONE) return false;
    if (file < count) return true;     /* read before */
    Mtl m = { .library = library, .notes = notes };
    int error_number;
    path = library->files.name[file];
    if (!text_open(&m.text, path, &error_number)) {
        note_name(notes, path, 0, "cannot be read:", m.text.error, strlen(m.text.error));
        return true;
    }
    bool ok = true, binary = false;
    Text *t = &m.text;
    uint32_t before = library->names.n;
    while (ok && !binary && text_more(t))
        for (char *p = t->p; ok && !binary && p < t->end;) {
            p = skip_blanks(p);
            char *end = p;
            if (!is_stop(*p)) {
                text_join(t, p);
                end = find_line_end(p);
                if (memchr(p, 0, (size_t)(end - p))) binary = true;
                else ok = statement(&m, p);
            }
            p = text_next_line(t, find_line_end(end));
        }
    if (binary) note(notes, path, t->line - 1, "binary data, the rest of the file is ignored");
    else if (t->error) note_name(notes, path, 0, "cannot be read:", t->error, strlen(t->error));
    else if (library->names.n == before) note(notes, path, 0, "no new material in this file");
    text_close(t);
    return ok;
}

/* Textures. */

/* The largest value of each channel; false if a value is negative or not finite. */
static bool largest_of(const Image *image, Rgb *largest)
{
    float high[3] = { 0, 0, 0 };
    size_t n = (size_t)image->width * image->height;
    for (size_t i = 0; i < n; i++)
        for (int c = 0; c < 3; c++) {
            float v = image->rgb[3 * i + (size_t)c];
            if (!(v >= 0 && v <= FLT_MAX)) return false;
            if (v > high[c]) high[c] = v;
        }
    *largest = from_float(high);
    return true;
}

static bool equal(Rgb a, Rgb b) { return a.x == b.x && a.y == b.y && a.z == b.z; }

/* The texture with this path and factor, made from the unscaled one if it has to be; NULL only if memory runs out. */
static MtlTexture *find_texture(MtlLibrary *library, const char *path, Rgb factor, Report *report, Notes *notes, const char *file, unsigned long line)
{
    MtlTexture *original = NULL;
    for (uint32_t i = 0; i < library->n_textures; i++) {
        MtlTexture *t = &library->texture[i];
        if (strcmp(t->path, path) != 0) continue;
        if (equal(t->factor, factor)) return t;
        if (!original) original = t;
    }
    size_t from = original ? (size_t)(original - library->texture) : 0;
    if (!array_grow(&library->texture, library->n_textures, &library->texture_capacity, sizeof *library->texture, 0)) return NULL;
    MtlTexture t = { .path = malloc(strlen(path) + 1), .factor = factor };
    if (!t.path) return NULL;
    strcpy(t.path, path);
    if (original) {
        original = &library->texture[from];
        t.largest = original->largest;
        t.image = image_new(original->image->width, original->image->height);
        if (!t.image) {
            free(t.path);
            return NULL;
        }
        size_t n = (size_t)t.image->width * t.image->height;
        for (size_t i = 0; i < n; i++) {
            t.image->rgb[3 * i] = (float)((double)original->image->rgb[3 * i] * factor.x);
            t.image->rgb[3 * i + 1] = (float)((double)original->image->rgb[3 * i + 1] * factor.y);
            t.image->rgb[3 * i + 2] = (float)((double)original->image->rgb[3 * i + 2] * factor.z);
        }
    } else {
        Report apart = { .warnings = report->warnings };
        t.image = image_read(path, &apart);
        report->warned += apart.warned;
        if (!t.image) note_name(notes, file, line, "texture cannot be read, Kd is used:", apart.error, strlen(apart.error));
        else if (!largest_of(t.image, &t.largest)) {
            note_name(notes, file, line, "texture with values that are no reflectance, Kd is used:", path, strlen(path));
            image_free(t.image);
            t.image = NULL;
        }
    }
    library->texture[library->n_textures] = t;
    return &library->texture[library->n_textures++];
}

bool mtl_textures(MtlLibrary *library, Image ***texture, uint32_t *n)
{
    *n = 0;
    if (library->n_textures == 0) return true;
    *texture = malloc(library->n_textures * sizeof **texture);
    if (!*texture) return false;
    for (uint32_t i = 0; i < library->n_textures; i++)
        if (library->texture[i].used) {
            (*texture)[(*n)++] = library->texture[i].image;
            library->texture[i].image = NULL;
        }
    return true;
}

void mtl_free(MtlLibrary *library)
{
    for (uint32_t i = 0; i < library->names.n; i++) free(library->entry[i].map_kd);
    for (uint32_t i = 0; i < library->n_textures; i++) {
        free(library->texture[i].path);
        if (library->texture[i].image) image_free(library->texture[i].image);
    }
    free(library->entry);
    free(library->texture);
    names_free(&library->names);
    names_free(&library->files);
}

/* Materials. */

static Rgb colour_or(Rgb c, double absent) { return isnan(c.x) ? vec3(absent, absent, absent) : c; }
static double or_else(double x, double absent) { return isnan(x) ? absent : x; }
static Rgb at_most_one(Rgb c) { return vec3(fmin(c.x, 1), fmin(c.y, 1), fmin(c.z, 1)); }
/* The factor that brings a sum above 1 to 1. */
static double excess(double sum) { return sum > 1 ? 1 / sum : 1; }

bool mtl_default(Material *material)
{
    *material = (Material){ .name = malloc(1), .kind = MATERIAL_DIFFUSE, .kd = vec3(0.5, 0.5, 0.5), .ni = 1 };
    if (!material->name) return false;
    material->name[0] = 0;
    return true;
}

bool mtl_material(MtlLibrary *library, uint32_t number, Material *material, Notes *notes, Report *report)
{
    static const char too_much[] = "materials that reflect more than all light are scaled down:";
    const MtlEntry *e = &library->entry[number];
    const char *name = library->names.name[number], *file = library->files.name[e->file];
    Material m = { .kind = MATERIAL_DIFFUSE, .ke = colour_or(e->ke, 0), .ns = or_else(e->ns, 0), .ni = or_else(e->ni, 1.5) };
    bool phong = false;
    switch (e->illum) {
    case 3: case 5: case 8: m.kind = MATERIAL_MIRROR; break;
    case 4: case 6: case 7: case 9: m.kind = MATERIAL_GLASS; break;
    case -1: case 2: phong = true; break;
    default: break;
    }
    MtlTexture *texture = NULL;
    Rgb whole = vec3(1, 1, 1), factor = whole;
    if (m.kind == MATERIAL_MIRROR) {
        Rgb ks = colour_or(e->ks, 1);
        m.ks = at_most_one(ks);
        if (max3(ks) > 1) note(notes, file, e->line, too_much);
    } else if (m.kind == MATERIAL_GLASS) {
        Rgb tf = colour_or(e->tf, 1);
        m.tf = at_most_one(tf);
        if (max3(tf) > 1) note(notes, file, e->line, too_much);
    } else {
        m.kd = colour_or(e->kd, 0.6);
        if (phong) m.ks = colour_or(e->ks, 0);
        if (e->map_kd && !e->map_found) note_name(notes, file, e->map_line, "texture not found, Kd is used:", e->map_kd, strlen(e->map_kd));
        if (e->map_found) {
            texture = find_texture(library, e->map_kd, whole, report, notes, file, e->map_line);
            if (!texture) return false;
            if (!texture->image) texture = NULL;
        }
        Rgb sum = add(m.ks, texture ? texture->largest : m.kd);
        factor = vec3(excess(sum.x), excess(sum.y), excess(sum.z));
        if (!equal(factor, whole)) note(notes, file, e->line, too_much);
        m.kd = mul(factor, m.kd);
        m.ks = mul(factor, m.ks);
        if (texture) {
            m.kd = vec3(fmin(m.kd.x, 1 - m.ks.x), fmin(m.kd.y, 1 - m.ks.y), fmin(m.kd.z, 1 - m.ks.z));     /* for faces without uv */
            texture = find_texture(library, e->map_kd, factor, report, notes, file, e->map_line);
            if (!texture) return false;
            texture->used = true;
            m.map_kd = texture->image;
            m.map_place = e->map_place;
        }
        double d = isnan(e->d) ? 1 - or_else(e->tr, 0) : e->d;
        if (d < 1) note(notes, file, e->line, isnan(e->d) && d == 0 ? "Tr 1 without d, which some programs mean as opaque, is taken as opaque"
                                                                    : "transparency by d or Tr is not supported, the material is opaque");
    }
    m.name = malloc(strlen(name) + 1);
    if (!m.name) return false;
    strcpy(m.name, name);
    *material = m;
    return true;
}

/* SCENE.cam. */

/* n numbers and nothing else. */
static bool camera_numbers(const Text *t, char *p, double *value, int n, Report *report)
{
    for (int i = 0; i < n; i++) {
        p = skip_blanks(p);
        if (is_stop(*p)) return report_error(report, t->path, t->line, "%d number%s expected, %d found", n, n > 1 ? "s" : "", i);
        char *end = skip_token(p);
        if (number_scan(p, &value[i]) != end) return report_error(report, t->path, t->line, "'%s' %s", quote_token(p).text, number_fault(p));
        p = end;
    }
    p = skip_blanks(p);
    return is_stop(*p) || report_error(report, t->path, t->line, "'%s' is more than the %d number%s expected", quote_token(p).text, n, n > 1 ? "s" : "");
}

static bool camera_vector(const Text *t, char *p, Vec3 *value, bool *has, Report *report)
{
    double v[3];
    if (!camera_numbers(t, p, v, 3, report)) return false;
    *value = vec3(v[0], v[1], v[2]);
    return *has = true;
}

static bool camera_number(const Text *t, char *p, double *value, bool *has, Report *report)
{
    return camera_numbers(t, p, value, 1, report) && (*has = true);
}

static bool camera_size(const Text *t, char *p, CameraSettings *s, Report *report)
{
    double v[2];
    if (!camera_numbers(t, p, v, 2, report)) return false;
    for (int i = 0; i < 2; i++)
        if (!(v[i] >= 1 && v[i] <= 65535 && v[i] == floor(v[i])))
            return report_error(report, t->path, t->line, "size must be two whole numbers from 1 to 65535");
    s->width = (uint32_t)v[0];
    s->height = (uint32_t)v[1];
    return s->has_size = true;
}

static bool camera_statement(const Text *t, char *p, CameraSettings *s, Report *report)
{
    char *word = p;
    size_t n = (size_t)(skip_token(p) - p);
    p += n;
    if (is_word(word, n, "eye")) return camera_vector(t, p, &s->eye, &s->has_eye, report);
    if (is_word(word, n, "look")) return camera_vector(t, p, &s->look, &s->has_look, report);
    if (is_word(word, n, "up"))
        return camera_vector(t, p, &s->up, &s->has_up, report)
            && (s->up.x != 0 || s->up.y != 0 || s->up.z != 0 || report_error(report, t->path, t->line, "up must not be 0 0 0"));
    if (is_word(word, n, "fov"))
        return camera_number(t, p, &s->fov, &s->has_fov, report)
            && ((s->fov > 0 && s->fov < 180) || report_error(report, t->path, t->line, "fov must lie between 0 and 180 degrees"));
    if (is_word(word, n, "size")) return camera_size(t, p, s, report);
    if (is_word(word, n, "aperture"))
        return camera_number(t, p, &s->aperture, &s->has_aperture, report)
            && (s->aperture >= 0 || report_error(report, t->path, t->line, "aperture must not be negative"));
    if (is_word(word, n, "focus"))
        return camera_number(t, p, &s->focus, &s->has_focus, report)
            && (s->focus > 0 || report_error(report, t->path, t->line, "focus must be positive"));
    return report_error(report, t->path, t->line, "unknown keyword '%s'", quote_token(word).text);
}

bool cam_read(CameraSettings *settings, const char *path, Report *report)
{
    Text text, *t = &text;
    int error_number;
    if (!text_open(t, path, &error_number)) return error_number == ENOENT || report_error(report, path, 0, "%s", t->error);
    CameraSettings read = *settings;
    bool ok = true;
    while (ok && text_more(t))
        for (char *p = t->p; ok && p < t->end;) {
            p = skip_blanks(p);
            if (!is_stop(*p)) {
                text_join(t, p);
                ok = camera_statement(t, p, &read, report);
            }
            if (ok) p = text_next_line(t, find_line_end(p));
        }
    if (ok && t->error) ok = report_error(report, path, 0, "%s", t->error);
    text_close(t);
    if (ok) *settings = read;
    return ok;
}
