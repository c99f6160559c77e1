/* Pictures in memory, PFM, PPM and PNG files written, and the error of one picture against another. Reading is in texture.c.
 *
 * Sources: PFM as Debevec's tools write it; netpbm's PPM; PNG specification (W3C) with RFC 1950 and 1951; sRGB after IEC 61966-2-1;
 * relMSE after Rousselle et al. 2011, the 0.01 scaled by the squared mean so that it does not depend on the exposure.
 * Must not know who renders the picture or what for. */
#include "image.h"
#include "output.h"
#include "png.h"
#include <assert.h>
#include <errno.h>
#include <string.h>
#include <strings.h>

Image *image_new(uint32_t width, uint32_t height)
{
    if (height && width > SIZE_MAX / (3 * sizeof(float)) / height) return NULL;
    Image *image = malloc(sizeof *image);
    float *rgb = calloc((size_t)width * height + 1, 3 * sizeof *rgb);     /* + 1: never a calloc of nothing, which may be NULL */
    if (!image || !rgb) {
        free(image);
        free(rgb);
        return NULL;
    }
    *image = (Image){ width, height, rgb };
    return image;
}

void image_free(Image *image)
{
    if (!image) return;
    free(image->rgb);
    free(image);
}

/* A pixel of a or b that is not finite shows: the errors it enters come out infinite or NaN. So does relmse against a black reference. */
ImageError image_compare(const Image *a, const Image *b)
{
    assert(a->width == b->width && a->height == b->height);
    size_t n = (size_t)a->width * a->height * 3;
    double sum_a = 0, sum_b = 0, squares = 0, relative = 0;
    for (size_t i = 0; i < n; i++) {
        sum_a += (double)a->rgb[i];
        sum_b += (double)b->rgb[i];
    }
    double mean = sum_b / (double)n;
    for (size_t i = 0; i < n; i++) {
        double reference = (double)b->rgb[i], difference = (double)a->rgb[i] - reference;
        squares += difference * difference;
        relative += difference * difference / (reference * reference + 0.01 * mean * mean);
    }
    return (ImageError){ sqrt(squares / (double)n), relative / (double)n, sum_a / sum_b };
}

/* ---- 8 bits ---- */

/* NaN and all below zero become 0, infinity 255. */
static unsigned char srgb_byte(double linear)
{
    if (!(linear > 0)) return 0;
    if (linear >= 1) return 255;
    double encoded = linear <= 0.0031308 ? 12.92 * linear : 1.055 * pow(linear, 1 / 2.4) - 0.055;
    return (unsigned char)(255 * encoded + 0.5);
}

static void srgb_row(const Image *image, uint32_t y, double factor, unsigned char *row)
{
    size_t n = (size_t)image->width * 3;
    const float *rgb = image->rgb + y * n;
    for (size_t i = 0; i < n; i++) row[i] = srgb_byte(factor * (double)rgb[i]);
}

/* ---- Deflate: one block with codes of its own, matches found by a table of the last place each four bytes were seen ---- */

typedef struct {
    unsigned char *bytes;      /* large enough for whatever comes */
    size_t n;
    uint64_t bits;             /* not yet written, the first one lowest */
    unsigned held;
} BitSink;

static void put_bits(BitSink *sink, unsigned value, unsigned bits)
{
    sink->bits |= (uint64_t)value << sink->held;
    for (sink->held += bits; sink->held >= 8; sink->held -= 8, sink->bits >>= 8) sink->bytes[sink->n++] = (unsigned char)sink->bits;
}

/* A token is a byte, or a match: its length in the upper half, its distance - 1 in the lower. */
static size_t find_matches(const unsigned char *data, size_t n, uint32_t *tokens)
{
    enum { HASH_BITS = 15, SHORTEST = 4 };          /* a match of three gains little over three short codes */
    size_t last[1 << HASH_BITS] = { 0 }, count = 0; /* place + 1 */
    for (size_t i = 0, covered = 0; i < n; i++) {
        size_t length = 0, distance = 0;
        if (n - i >= SHORTEST) {
            uint32_t four;
            memcpy(&four, data + i, 4);
            size_t *seen = &last[four * 2654435761u >> (32 - HASH_BITS)];
            if (i >= covered && *seen && i + 1 - *seen <= WINDOW) {
                distance = i + 1 - *seen;
                while (length < MATCH_MAX && i + length < n && data[i + length] == data[i + length - distance]) length++;
            }
            *seen = i + 1;
        }
        if (i < covered) continue;
        bool match = length >= SHORTEST;
        tokens[count++] = match ? (uint32_t)(length << 16 | (distance - 1)) : data[i];
        covered = i + (match ? length : 1);
    }
    return count;
}

static unsigned length_code(unsigned length)
{
    unsigned code = 28;
    while (length_base(code) > length) code--;
    return code;
}

static unsigned distance_code(unsigned distance)
{
    unsigned code = DISTANCES - 1;
    while (distance_base(code) > distance) code--;
    return code;
}

/* Huffman's construction, the two lightest nodes sought by looking at all: few hundred symbols, once per picture.
 * Too deep a tree is built again from flattened frequencies. Two symbols or more must occur. */
static void huffman_lengths(size_t *frequency, unsigned n, unsigned char *lengths)
{
    for (unsigned deepest = CODE_BITS + 1; deepest > CODE_BITS;) {
        size_t weight[2 * LITERALS] = { 0 };        /* 0: no such node, or already below another */
        unsigned parent[2 * LITERALS] = { 0 }, nodes = n;
        for (unsigned i = 0; i < n; i++) weight[i] = frequency[i];
        for (;;) {
            unsigned a = nodes, b = nodes;          /* the lightest and the next */
            for (unsigned i = 0; i < nodes; i++) {
                if (!weight[i]) continue;
                if (a == nodes || weight[i] < weight[a]) { b = a; a = i; }
                else if (b == nodes || weight[i] < weight[b]) b = i;
            }
            if (b == nodes) break;
            weight[nodes] = weight[a] + weight[b];
            weight[a] = weight[b] = 0;
            parent[a] = parent[b] = nodes++;
        }
        deepest = 0;
        for (unsigned i = 0; i < n; i++) {
            unsigned depth = 0;
            for (unsigned node = i; parent[node]; node = parent[node]) depth++;
            if (depth > deepest) deepest = depth;
            lengths[i] = (unsigned char)depth;
            if (frequency[i]) frequency[i] = frequency[i] / 2 + 1;
        }
    }
}

/* A zlib stream of data[n] into sink, which has room for 2 n + 1024 bytes: a byte costs 15 bits at most, a match of four or more 48. */
static bool zlib_compress(const unsigned char *data, size_t n, BitSink *sink)
{
    uint32_t *tokens = malloc(n * sizeof *tokens + 1);
    if (!tokens) return false;
    size_t count = find_matches(data, n, tokens);

    /* A distance code of two symbols at least, as some readers refuse a lesser one. */
    size_t frequency[LITERALS] = { [END_OF_BLOCK] = 1 }, distance_frequency[DISTANCES] = { 1, 1 };
    for (size_t i = 0; i < count; i++) {
        unsigned length = tokens[i] >> 16, distance = (tokens[i] & 0xffff) + 1;
        frequency[length ? 257 + length_code(length) : tokens[i]]++;
        if (length) distance_frequency[distance_code(distance)]++;
    }
    unsigned char lengths[LITERALS + DISTANCES], *distance_lengths = lengths + LITERALS;
    uint16_t codes[LITERALS], distance_codes[DISTANCES];
    huffman_lengths(frequency, LITERALS, lengths);
    huffman_lengths(distance_frequency, DISTANCES, distance_lengths);
    huffman_codes(lengths, LITERALS, codes);
    huffman_codes(distance_lengths, DISTANCES, distance_codes);

    put_bits(sink, 0x0178, 16);                     /* zlib: deflate with a window of 32K; 0x7801 is a multiple of 31 */
    put_bits(sink, 1 | 2 << 1, 3);                  /* last block, codes of its own */
    put_bits(sink, LITERALS - 257, 5);
    put_bits(sink, DISTANCES - 1, 5);
    /* The lengths 0..15 are sent in four bits each: a code of sixteen equal lengths is the numbers themselves, bit-reversed. */
    put_bits(sink, 19 - 4, 4);
    for (unsigned i = 0; i < 19; i++) put_bits(sink, i < 3 ? 0 : 4, 3);     /* the first three would be 16, 17, 18: repeats */
    for (unsigned i = 0; i < LITERALS + DISTANCES; i++)
        for (unsigned bit = 4; bit-- > 0;) put_bits(sink, lengths[i] >> bit & 1, 1);

    for (size_t i = 0; i < count; i++) {
        unsigned length = tokens[i] >> 16, distance = (tokens[i] & 0xffff) + 1;
        unsigned symbol = length ? 257 + length_code(length) : tokens[i];
        put_bits(sink, codes[symbol], lengths[symbol]);
        if (!length) continue;
        put_bits(sink, length - length_base(symbol - 257), length_extra(symbol - 257));
        unsigned far = distance_code(distance);
        put_bits(sink, distance_codes[far], distance_lengths[far]);
        put_bits(sink, distance - distance_base(far), distance_extra(far));
    }
    put_bits(sink, codes[END_OF_BLOCK], lengths[END_OF_BLOCK]);
    put_bits(sink, 0, (8 - sink->held) % 8);
    uint32_t adler = png_adler(data, n);
    for (int shift = 24; shift >= 0; shift -= 8) put_bits(sink, adler >> shift & 255, 8);
    free(tokens);
    return true;
}

/* ---- Files. Each writer returns false with errno set. ---- */

static bool write_pfm(const Image *image, double factor, FILE *file)
{
    (void)factor;                                   /* linear light as it is */
    size_t n = (size_t)image->width * 3;
    unsigned char *row = malloc(n * 4 + 1);
    bool good = row && fprintf(file, "PF\n%lu %lu\n-1.0\n", (unsigned long)image->width, (unsigned long)image->height) > 0;
    for (uint32_t y = image->height; good && y-- > 0;) {
        for (size_t i = 0; i < n; i++) {
            uint32_t bits;
            memcpy(&bits, &image->rgb[y * n + i], sizeof bits);
            for (unsigned k = 0; k < 4; k++) row[4 * i + k] = (unsigned char)(bits >> 8 * k);
        }
        good = fwrite(row, 4, n, file) == n;
    }
    free(row);
    return good;
}

static bool write_ppm(const Image *image, double factor, FILE *file)
{
    size_t n = (size_t)image->width * 3;
    unsigned char *row = malloc(n + 1);
    bool good = row && fprintf(file, "P6\n%lu %lu\n255\n", (unsigned long)image->width, (unsigned long)image->height) > 0;
    for (uint32_t y = 0; good && y < image->height; y++) {
        srgb_row(image, y, factor, row);
        good = fwrite(row, 1, n, file) == n;
    }
    free(row);
    return good;
}

static void put_u32(unsigned char *at, uint32_t value)
{
    for (unsigned k = 0; k < 4; k++) at[k] = (unsigned char)(value >> (24 - 8 * k));
}

static bool write_chunk(FILE *file, const char *type, const unsigned char *data, size_t n)
{
    unsigned char head[8], crc[4];
    put_u32(head, (uint32_t)n);
    memcpy(head + 4, type, 4);
    put_u32(crc, png_crc(png_crc(0, head + 4, 4), data, n));
    return fwrite(head, 1, 8, file) == 8 && fwrite(data, 1, n, file) == n && fwrite(crc, 1, 4, file) == 4;
}

/* Filters one row of n bytes as type (0 none, 1 left, 2 above, 3 their mean, 4 Paeth) into out; returns the sum of the signed bytes' sizes,
 * the usual guess at how well it will compress. row and above have three zeros before them. */
static unsigned long filter_row(unsigned type, const unsigned char *row, const unsigned char *above, size_t n, unsigned char *out)
{
    unsigned long cost = 0;
    for (size_t i = 0; i < n; i++) {
        const unsigned char *left = row + i - 3;
        unsigned guess = type == 1 ? *left : type == 2 ? above[i] : type == 3 ? (*left + above[i]) / 2u
            : type == 4 ? png_paeth(*left, above[i], above[(ptrdiff_t)i - 3]) : 0;
        out[i] = (unsigned char)(row[i] - guess);
        cost += out[i] < 128 ? out[i] : 256u - out[i];
    }
    return cost;
}

static bool write_png(const Image *image, double factor, FILE *file)
{
    size_t n = (size_t)image->width * 3, line = n + 1, size = line * image->height;
    if (size > 0x3fffffff) {                        /* twice this must fit one chunk */
        errno = EFBIG;
        return false;
    }
    unsigned char *rows = calloc(2, n + 3), *lines = malloc(size + line), *packed = malloc(2 * size + 1024);
    BitSink sink = { packed, 0, 0, 0 };
    bool good = rows && lines && packed;
    for (uint32_t y = 0; good && y < image->height; y++) {
        unsigned char *row = rows + y % 2 * (n + 3) + 3, *above = rows + (y + 1) % 2 * (n + 3) + 3;
        unsigned char *best = lines + y * line, *trial = lines + size;
        srgb_row(image, y, factor, row);
        unsigned long lowest = filter_row(0, row, above, n, best + 1);
        best[0] = 0;
        for (unsigned type = 1; type <= 4; type++) {
            unsigned long cost = filter_row(type, row, above, n, trial + 1);
            trial[0] = (unsigned char)type;
            if (cost < lowest) {
                lowest = cost;
                memcpy(best, trial, line);
            }
        }
    }
    unsigned char header[13] = { 0 };
    put_u32(header, image->width);
    put_u32(header + 4, image->height);
    header[8] = 8;                                  /* bits a sample */
    header[9] = 2;                                  /* RGB */
    static const unsigned char perceptual = 0;
    good = good && zlib_compress(lines, size, &sink)
        && fwrite("\x89PNG\r\n\x1a\n", 1, 8, file) == 8 && write_chunk(file, "IHDR", header, sizeof header)
        && write_chunk(file, "sRGB", &perceptual, 1) && write_chunk(file, "IDAT", packed, sink.n) && write_chunk(file, "IEND", header, 0);
    free(rows);
    free(lines);
    free(packed);
    return good;
}

typedef bool Writer(const Image *image, double factor, FILE *file);

static Writer *find_writer(const char *path)
{
    static const struct { const char *ending; Writer *write; } formats[] = {
        { ".pfm", write_pfm }, { ".ppm", write_ppm }, { ".png", write_png }
    };
    const char *dot = strrchr(path, '.');
    for (size_t i = 0; dot && i < sizeof formats / sizeof *formats; i++)
        if (strcasecmp(dot, formats[i].ending) == 0) return formats[i].write;
    return NULL;
}

bool image_format_known(const char *path) { return find_writer(path) != NULL; }

bool image_write(const Image *image, const char *path, double exposure_ev, Report *report)
{
    Writer *write_file = find_writer(path);
    if (!write_file) return report_error(report, path, 0, "the name must end in .pfm, .ppm or .png");
    Output out;
    if (!output_open(&out, path, report)) return false;
    return output_close(&out, path, write_file(image, exp2(exposure_ev), out.file), report);
}
