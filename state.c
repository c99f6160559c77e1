/* A run's state on file: saved, resumed, merged with others. See render.h.
 *
 * The file is a header, the accumulators as they lie in memory, and a checksum of both; what the scene holds is not in it but for a hash that must
 * agree. What was read is believed only because the checksum was right. */
#include "run.h"
#include <errno.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

static const uint64_t HASH_OF_NOTHING = 0xcbf29ce484222325u;

/* FNV-1a by words of 8 bytes, the last one filled up with 0; the shift lets high bits have a say in low ones. */
static void hash(uint64_t *h, const void *data, size_t n)
{
    const unsigned char *p = data;
    uint64_t word;
    for (; n >= sizeof word; p += sizeof word, n -= sizeof word) {
        memcpy(&word, p, sizeof word);
        *h = (*h ^ word) * 0x100000001b3u;
        *h ^= *h >> 32;
    }
    if (n == 0) return;
    word = 0;
    memcpy(&word, p, n);
    *h = (*h ^ word) * 0x100000001b3u;
}

static void hash_number(uint64_t *h, double v) { hash(h, &v, sizeof v); }
static void hash_vector(uint64_t *h, Vec3 v) { hash(h, &v, sizeof v); }

/* Normals or texture coordinates of the corners of triangles; where a face has none, only the first index says anything. */
static void hash_corners(uint64_t *h, const uint32_t (*corner)[3], uint32_t n)
{
    for (uint32_t i = 0; corner && i < n; i++) hash(h, corner[i], corner[i][0] == BVH_NONE ? sizeof **corner : sizeof *corner);
}

/* Of all that must agree between runs that are resumed or merged. */
static uint64_t identity(const Scene *scene, const Settings *s)
{
    uint64_t h = HASH_OF_NOTHING;
    const Mesh *m = &scene->mesh;
    const Camera *c = &scene->camera;
    hash(&h, m->position, m->n_positions * sizeof *m->position);
    hash(&h, m->triangle, m->n_triangles * sizeof *m->triangle);
    hash(&h, m->triangle_material, m->n_triangles * sizeof *m->triangle_material);
    if (m->normal) hash(&h, m->normal, m->n_normals * sizeof *m->normal);
    if (m->uv) hash(&h, m->uv, m->n_uvs * sizeof *m->uv);
    hash_corners(&h, (const uint32_t (*)[3])m->triangle_normal, m->n_triangles);
    hash_corners(&h, (const uint32_t (*)[3])m->triangle_uv, m->n_triangles);
    for (uint32_t i = 0; i < m->n_materials; i++) {
        const Material *a = &m->material[i];
        const Vec3 colours[] = { a->kd, a->ks, a->tf, a->ke };
        for (int j = 0; j < 4; j++) hash_vector(&h, colours[j]);
        hash_number(&h, a->ns);
        hash_number(&h, a->ni);
        hash_number(&h, a->kind);
        if (!a->map_kd) continue;
        hash(&h, a->map_kd->rgb, 12 * (size_t)a->map_kd->width * a->map_kd->height);
        for (int j = 0; j < 2; j++) {
            hash_number(&h, a->map_place.scale[j]);
            hash_number(&h, a->map_place.offset[j]);
        }
        hash_number(&h, a->map_place.clamp);
    }
    const Vec3 axes[] = { c->eye, c->right, c->up, c->forward };
    for (int j = 0; j < 4; j++) hash_vector(&h, axes[j]);
    const double numbers[] = { c->half_width, c->half_height, c->aperture, c->focus, c->width, c->height, s->integrator, s->direct, s->max_depth,
                               s->strategies, (double)s->bootstrap, (double)s->chains };
    hash(&h, numbers, sizeof numbers);
    return h;
}

static const char MAGIC[] = "MLTRUNG\n";            /* the number changes with what is kept */

typedef struct {
    char magic[8];
    uint64_t identity, seed, path_bytes;
    uint32_t width, height;
    uint32_t integrator, direct;
    uint32_t specular, narrow;     /* Scene.has_specular, has_narrow */
} Header;

typedef struct { FILE *file; bool write, ok; } Stream;

static void pass(Stream *s, void *data, size_t n)
{
    if (s->ok && n > 0) s->ok = (s->write ? fwrite(data, 1, n, s->file) : fread(data, 1, n, s->file)) == n;
}

static void pass_array(Stream *s, void *data, size_t n) { if (data) pass(s, data, n); }

/* The chain's path: its vertices name materials by number in the file. */
static void pass_path(Stream *s, Path *x, const Mesh *mesh)
{
    pass(s, x, offsetof(Path, v));
    if (!s->ok || x->k < 0 || x->k > MAX_EDGES) { s->ok = false; return; }
    for (int i = 0; i <= x->k; i++) {
        Vertex v = x->v[i];
        const Material *m = v.point.surface.material;
        uint32_t number = s->write && m ? (uint32_t)(m - mesh->material) : BVH_NONE;
        v.point.surface.material = NULL;
        pass(s, &v, sizeof v);
        pass(s, &number, sizeof number);
        if (s->write || !s->ok) continue;
        if (number != BVH_NONE && number >= mesh->n_materials) { s->ok = false; return; }
        v.point.surface.material = number == BVH_NONE ? NULL : &mesh->material[number];
        x->v[i] = v;
    }
}

/* What only a scene gives a meaning: seeds, and the path of the chain under way. */
static void pass_paths(Stream *s, Render *r)
{
    for (int i = 0; i < SEEDS && s->ok && r->met.sum > 0; i++) pass_path(s, &r->met.seed[i], &r->scene->mesh);
    if (s->ok && r->round.phase == CHAINS && r->round.left > 0) pass_path(s, r->x, &r->scene->mesh);
}

/* One list of all that is kept, for both directions. */
static void pass_state(Stream *s, Render *r)
{
    size_t doubles = 3 * r->pixels * sizeof(double);
    double *arrays[] = { r->passes.sum, r->passes.square, r->passes.light, r->passes.light_square, r->sum, r->square };
    for (size_t i = 0; i < sizeof arrays / sizeof *arrays; i++) pass_array(s, arrays[i], doubles);
    pass_array(s, r->passes.first, run_firsts(r) * sizeof *r->passes.first);
    pass_array(s, r->passes.direct, r->pixels * sizeof *r->passes.direct);
    pass_array(s, r->passes.count, r->scene->camera.height * sizeof *r->passes.count);
    pass_array(s, r->passes.often, r->pixels * sizeof *r->passes.often);
    pass_array(s, r->passes.cost, r->pixels * sizeof *r->passes.cost);
    pass_array(s, r->passes.alike, r->scene->camera.height * sizeof *r->passes.alike);
    pass_array(s, r->film, r->pixels * sizeof *r->film);
    pass_array(s, r->picture, r->pixels * sizeof *r->picture);
    pass_array(s, r->emission, sizeof *r->emission);
    bool early = r->early != NULL;
    pass(s, &early, sizeof early);
    if (!s->write && s->ok && early) s->ok = (r->early = image_new(r->scene->camera.width, r->scene->camera.height)) != NULL;
    if (early && s->ok) pass(s, r->early->rgb, 3 * r->pixels * sizeof *r->early->rgb);
    pass(s, &r->passes.offset, sizeof r->passes.offset);
    pass(s, &r->passes.settled, sizeof r->passes.settled);
    pass(s, &r->passes.rows, sizeof r->passes.rows);
    pass(s, &r->passes.rays, sizeof r->passes.rays);
    pass(s, &r->passes.evenness, sizeof r->passes.evenness);
    pass(s, r->scene->rays, sizeof *r->scene->rays);
    double *numbers[] = { &r->steps_sum, &r->steps_square, &r->b_sum, &r->b_variance_sum, &r->rate, &r->samples_rate, &r->direct_share, &r->start_share,
                          &r->samples_per_step, &r->seeds, &r->seeds_before, &r->persistence, &r->apart_sum, &r->rays_per_step, &r->met_variance_sum, &r->relative_error, &r->learned,
                          &r->tau, &r->whole_error, &r->left, &r->passes.cut, &r->passes.cut_square };
    for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++) pass(s, numbers[i], sizeof(double));
    uint64_t divided = r->chain_space.part != WHOLE;
    pass(s, r->tile, sizeof r->tile);
    pass(s, &divided, sizeof divided);
    pass(s, &r->bidirectional, sizeof r->bidirectional);
    pass(s, &r->direct_joined, sizeof r->direct_joined);
    pass(s, &r->bent, sizeof r->bent);
    pass(s, &r->seeds_bent, sizeof r->seeds_bent);
    pass(s, &r->catches, sizeof r->catches);
    pass(s, &r->surveyed, sizeof r->surveyed);
    pass(s, &r->pilot, sizeof r->pilot);
    if (divided && !s->write) run_divide(r);
    pass(s, &r->sampler.tuning, sizeof r->sampler.tuning);
    pass(s, &r->round, sizeof r->round);
    Path *seed = r->met.seed;
    pass(s, &r->met, sizeof r->met);
    r->met.seed = seed;
    pass(s, &r->rounds, sizeof r->rounds);
    pass(s, &r->last_round, sizeof r->last_round);
    pass(s, &r->more_pilots, sizeof r->more_pilots);
    pass(s, &r->stats, sizeof r->stats);
}

static Header header_of(const Render *r)
{
    const Camera *c = &r->scene->camera;
    Header header = { .identity = identity(r->scene, r->settings), .seed = r->settings->seed, .path_bytes = sizeof(Path), .width = c->width,
                      .height = c->height, .integrator = (uint32_t)r->settings->integrator, .direct = (uint32_t)r->settings->direct,
                      .specular = r->scene->has_specular, .narrow = r->scene->has_narrow };
    memcpy(header.magic, MAGIC, sizeof header.magic);
    return header;
}

/* The checksum of the first n bytes of a file, which is then at its n-th. False if it cannot be read so far. */
static bool file_sum(FILE *file, off_t n, uint64_t *sum)
{
    unsigned char block[1 << 16];
    *sum = HASH_OF_NOTHING;
    bool ok = fseeko(file, 0, SEEK_SET) == 0;
    while (ok && n > 0) {
        size_t bytes = n < (off_t)sizeof block ? (size_t)n : sizeof block;
        ok = fread(block, 1, bytes, file) == bytes;
        hash(sum, block, bytes);
        n -= (off_t)bytes;
    }
    return ok;
}

bool render_save(const Render *r, const char *path, Report *report)
{
    size_t n = strlen(path);
    char *temporary = malloc(n + 5);
    if (!temporary) return report_error(report, path, 0, "out of memory");
    memcpy(temporary, path, n);
    memcpy(temporary + n, ".tmp", 5);
    Stream s = { fopen(temporary, "w+b"), true, true };
    bool ok = s.file != NULL;
    if (ok) {
        Header header = header_of(r);
        pass(&s, &header, sizeof header);
        pass_state(&s, (Render *)r);               /* reads only, when writing */
        pass_paths(&s, (Render *)r);
        uint64_t sum;
        s.ok = s.ok && fflush(s.file) == 0 && file_sum(s.file, ftello(s.file), &sum) && fseeko(s.file, 0, SEEK_END) == 0;
        pass(&s, &sum, sizeof sum);
        ok = (fclose(s.file) == 0) & s.ok;
        ok = ok && rename(temporary, path) == 0;
    }
    if (!ok) {
        report_error(report, path, 0, "the run's state cannot be written: %s", strerror(errno));
        if (s.file) remove(temporary);
    }
    free(temporary);
    return ok;
}

static bool damaged(const char *path, Report *report) { return report_error(report, path, 0, "the saved state is damaged"); }

/* Opens a state file that is whole, and reads its header. */
static FILE *open_state(const char *path, Header *header, Report *report)
{
    FILE *file = fopen(path, "rb");
    uint64_t sum, kept;
    off_t end;
    bool ok = file != NULL;
    if (!ok) report_error(report, path, 0, "%s", strerror(errno));
    else if (fread(header, sizeof *header, 1, file) != 1 || memcmp(header->magic, MAGIC, sizeof header->magic) != 0 || header->path_bytes != sizeof(Path))
        ok = report_error(report, path, 0, "not the saved state of a run, or of another version of mlt");
    else if (fseeko(file, -(off_t)sizeof sum, SEEK_END) != 0 || (end = ftello(file)) < (off_t)sizeof *header || !file_sum(file, end, &sum)
          || fread(&kept, sizeof kept, 1, file) != 1 || kept != sum || fseeko(file, sizeof *header, SEEK_SET) != 0)
        ok = damaged(path, report);
    if (ok || !file) return file;
    fclose(file);
    return NULL;
}

/* Whether the file has ended but for its checksum. */
static bool at_sum(FILE *file)
{
    uint64_t sum;
    return fread(&sum, sizeof sum, 1, file) == 1 && getc(file) == EOF;
}

bool render_resume(Render *r, const char *path, Report *report)
{
    Header header, mine = header_of(r);
    FILE *file = open_state(path, &header, report);
    if (!file) return false;
    bool ok = header.identity == mine.identity && header.seed == mine.seed && header.width == mine.width && header.height == mine.height;
    if (!ok) report_error(report, path, 0, "the saved run is of another scene, other options or another seed");
    else {
        Stream s = { file, false, true };
        pass_state(&s, r);
        pass_paths(&s, r);
        ok = (s.ok && at_sum(file)) || damaged(path, report);
        if (ok && r->has_chain) run_go_on(r);
    }
    fclose(file);
    return ok;
}

static void add_array(double *to, const double *from, size_t n)
{
    if (to) for (size_t i = 0; i < n; i++) to[i] += from[i];
}

/* A run read from a file without its scene: film size and accumulators are all that a picture needs. */
static Render *read_run(FILE *file, const Header *header, const char *path, Report *report)
{
    Scene *scene = calloc(1, sizeof *scene);
    Settings *settings = calloc(1, sizeof *settings);
    Render *r = NULL;
    if (scene && settings && (scene->rays = calloc(1, sizeof *scene->rays))) {
        scene->camera.width = header->width;
        scene->camera.height = header->height;
        scene->has_specular = header->specular;
        scene->has_narrow = header->narrow;
        settings->integrator = (Integrator)header->integrator;
        settings->direct = (DirectLight)header->direct;
        settings->seed = header->seed;
        r = render_new(scene, settings);
    }
    if (!r) {
        if (scene) free(scene->rays);
        free(scene);
        free(settings);
        report_error(report, path, 0, "out of memory");
        return NULL;
    }
    Stream s = { file, false, true };
    pass_state(&s, r);
    if (s.ok) {
        if (r->has_chain) run_close_chains(r);
        return r;
    }
    damaged(path, report);
    render_merged_free(r);
    return NULL;
}

void render_merged_free(Render *r)
{
    if (!r) return;
    Scene *scene = (Scene *)r->scene;
    Settings *settings = (Settings *)r->settings;
    render_free(r);
    free(scene->rays);
    free(scene);
    free(settings);
}

/* Where path space is cut between chains and path tracer, every run has its own cut: the parts of different runs are parts of different integrals, and
 * each run can only be taken whole. Adds its picture and that picture's variance, weighted by the run's rays, to the accumulators of the chains;
 * 'to' may be the run itself, which is then the first. False if memory runs out. */
static bool add_whole(Render *to, const Render *run)
{
    Image *value = image_new(run->scene->camera.width, run->scene->camera.height), *error = image_new(run->scene->camera.width, run->scene->camera.height);
    bool ok = value && error, first = to == run;
    if (ok) {
        double weight = (double)*run->scene->rays;
        render_image(run, value);
        render_error_image(run, error);
        for (size_t i = 0; i < 3 * to->pixels; i++) {
            double v = (double)value->rgb[i], e = (double)error->rgb[i];
            to->sum[i] = (first ? 0 : to->sum[i]) + weight * v;
            to->square[i] = (first ? 0 : to->square[i]) + weight * weight * e * e;
        }
        to->steps_sum = (first ? 0 : to->steps_sum) + weight;
        to->has_direct = false;
    }
    image_free(value);
    image_free(error);
    return ok;
}

/* Turns what add_whole has added up into what an estimate is read from: as if two rounds of equal length had this mean and this variance; or one, of which
 * no variance is known. */
static void close_whole(Render *r, bool known)
{
    double W = r->steps_sum;
    r->steps_square = known ? W * W / 2 : W * W;
    for (size_t i = 0; W > 0 && i < 3 * r->pixels; i++) {
        double mean = r->sum[i] / W;
        r->square[i] = W * (mean * mean + r->square[i] / (W * W));
    }
}

Render *render_merge(const char *const *path, int n, Report *report)
{
    Render *merged = NULL;
    bool known = true, whole = false;
    uint64_t *seeds = malloc((size_t)n * sizeof *seeds), first = 0;
    bool ok = seeds != NULL;
    if (!ok) report_error(report, NULL, 0, "out of memory");
    for (int i = 0; ok && i < n; i++) {
        Header header;
        FILE *file = open_state(path[i], &header, report);
        ok = file != NULL;
        if (!ok) break;
        if (i == 0) first = header.identity;
        seeds[i] = header.seed;
        Render *r = NULL;
        if (header.identity != first) ok = report_error(report, path[i], 0, "another scene or other options than %.300s", path[0]);
        for (int j = 0; ok && j < i; j++)
            if (seeds[j] == header.seed) ok = report_error(report, path[i], 0, "the same seed as %.300s: the runs are not independent", path[j]);
        if (ok) ok = (r = read_run(file, &header, path[i], report)) != NULL;
        fclose(file);
        if (!ok) break;
        if (!run_begun(r)) {
            report_warning(report, path[i], 0, "the run was stopped before it had a picture of its own, and is left out");
            render_merged_free(r);
            continue;
        }
        known = known && (r->stats.b == 0 || r->steps_square < r->steps_sum * r->steps_sum);
        free(r->passes.first);                 /* of runs together it tells nothing: each has measured its evenness */
        r->passes.first = NULL;
        if (!merged) {
            merged = r;
            whole = r->has_chain && r->has_direct;
            if (whole) ok = add_whole(r, r) || report_error(report, NULL, 0, "out of memory");
            continue;
        }
        merged->stats.chain.steps += r->stats.chain.steps;
        merged->stats.bad_samples += r->stats.bad_samples;
        merged->rounds += r->rounds;
        if (whole) {
            ok = add_whole(merged, r) || report_error(report, NULL, 0, "out of memory");
            render_merged_free(r);
            continue;
        }
        double *to[] = { merged->passes.sum, merged->passes.square, merged->passes.light, merged->passes.light_square, merged->sum, merged->square };
        double *from[] = { r->passes.sum, r->passes.square, r->passes.light, r->passes.light_square, r->sum, r->square };
        for (size_t a = 0; a < sizeof to / sizeof *to; a++) add_array(to[a], from[a], 3 * r->pixels);
        if (merged->passes.direct) add_array(merged->passes.direct, r->passes.direct, r->pixels);
        for (uint32_t row = 0; merged->passes.count && row < header.height; row++) merged->passes.count[row] += r->passes.count[row];
        if (r->passes.rows > 0) {
            double share = (double)r->passes.rows / (double)(merged->passes.rows + r->passes.rows);
            Evenness *all = &merged->passes.evenness, *of = &r->passes.evenness;
            for (int k = 0; k < BRIGHTNESSES; k++) all->kind[k] += share * (of->kind[k] - all->kind[k]);
            for (int t = 0; t < TILES_ACROSS * TILES_ACROSS; t++) all->tile[t] += share * (of->tile[t] - all->tile[t]);
            all->mean += share * (of->mean - all->mean);
        }
        merged->passes.rows += r->passes.rows;
        merged->steps_sum += r->steps_sum;
        merged->steps_square += r->steps_square;
        merged->b_sum += r->b_sum;
        merged->b_variance_sum += r->b_variance_sum;
        merged->met_variance_sum += r->met_variance_sum;
        render_merged_free(r);
    }
    free(seeds);
    if (ok && !merged) ok = report_error(report, NULL, 0, "no run is left to merge");
    if (ok) {
        if (whole) close_whole(merged, known);
        else if (merged->steps_sum > 0) merged->stats.b = merged->b_sum / merged->steps_sum;
        run_learn(merged);
        return merged;
    }
    render_merged_free(merged);
    return NULL;
}
