/* Tests image.c and texture.c: what is written reads back, what others write reads as it should, and what is broken, cut short or absent
 * comes back as an error. Files of the formats read are built here from chosen samples, so that each pixel's value is known; the
 * zlib_... arrays were made by zlib itself. */
#include "check.h"
#include "folder.h"
#include "../image.h"
#include "../png.h"
#include <errno.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/stat.h>

/* ---- Bytes to build files in ---- */

typedef struct { unsigned char at[1 << 16]; size_t n; } Bytes;

static void put(Bytes *b, const void *data, size_t n)
{
    memcpy(b->at + b->n, data, n);
    b->n += n;
}
static void put_byte(Bytes *b, unsigned value) { b->at[b->n++] = (unsigned char)value; }
static void put_text(Bytes *b, const char *text) { put(b, text, strlen(text)); }
static void put_big(Bytes *b, uint32_t value, unsigned bytes) { while (bytes-- > 0) put_byte(b, value >> 8 * bytes & 255); }
static void put_little(Bytes *b, uint32_t value, unsigned bytes) { for (; bytes-- > 0; value >>= 8) put_byte(b, value & 255); }

/* Decodes from memory of exactly n bytes, so that a sanitizer sees a byte read too many. */
static Image *decode(const unsigned char *data, size_t n, Report *report)
{
    unsigned char *copy = malloc(n + !n);
    if (n) memcpy(copy, data, n);
    *report = (Report){ .warnings = stdout };
    Image *image = image_decode(copy, n, "name", report);
    free(copy);
    return image;
}

/* True if these bytes are refused with 'name: ...text...'. */
static bool refused(const unsigned char *data, size_t n, const char *text)
{
    Report report;
    Image *image = decode(data, n, &report);
    bool good = !image && strncmp(report.error, "name: ", 6) == 0 && strstr(report.error, text);
    if (!good) printf("expected '%s', got %s, error '%s'\n", text, image ? "a picture" : "no picture", report.error);
    image_free(image);
    return good;
}
static bool text_refused(const char *data, const char *text) { return refused((const unsigned char *)data, strlen(data), text); }

/* The number of beginnings of these bytes, from length `from` on, that are taken for a picture: none should. */
static int beginnings_taken(const Bytes *b, size_t from)
{
    int taken = 0;
    for (size_t n = from; n < b->n; n++) {
        Report report;
        Image *image = decode(b->at, n, &report);
        taken += image || strncmp(report.error, "name: ", 6) != 0;
        image_free(image);
    }
    return taken;
}

/* The number of bytes that can be changed without notice. */
static int changes_taken(const Bytes *b)
{
    int taken = 0;
    static Bytes copy;
    copy = *b;
    for (size_t i = 0; i < b->n; i++) {
        Report report;
        copy.at[i] ^= (unsigned char)(1 << i % 8);
        Image *image = decode(copy.at, copy.n, &report);
        taken += image != NULL;
        image_free(image);
        copy.at[i] = b->at[i];
    }
    return taken;
}

static double from_srgb(double v) { return v <= 0.04045 ? v / 12.92 : pow((v + 0.055) / 1.055, 2.4); }
static double to_srgb(double v) { return v <= 0.0031308 ? 12.92 * v : 1.055 * pow(v, 1 / 2.4) - 0.055; }

/* The expected linear value of channel k at x, y. */
typedef double Expected(const void *context, unsigned x, unsigned y, unsigned k);

static bool shows(const Bytes *b, unsigned width, unsigned height, Expected *expected, const void *context)
{
    Report report;
    Image *image = decode(b->at, b->n, &report);
    int wrong = 0;
    if (!image) printf("%s\n", report.error);
    bool good = image && image->width == width && image->height == height;
    for (unsigned i = 0; good && i < width * height * 3; i++) {
        double value = (double)image->rgb[i], wanted = expected(context, i / 3 % width, i / 3 / width, i % 3);
        if (!(fabs(value - wanted) <= 1e-6 * wanted) && wrong++ < 3)
            printf("x %u, y %u, channel %u: %.9g, expected %.9g\n", i / 3 % width, i / 3 / width, i % 3, value, wanted);
    }
    image_free(image);
    return good && wrong == 0;
}

/* ---- PNG ---- */

static const char png_mark[] = "\x89PNG\r\n\x1a\n";

static void put_chunk(Bytes *b, const char *type, const void *data, size_t n)
{
    size_t begin = b->n + 4;
    put_big(b, (uint32_t)n, 4);
    put(b, type, 4);
    put(b, data, n);
    put_big(b, png_crc(0, b->at + begin, n + 4), 4);
}

static void put_header(Bytes *b, uint32_t width, uint32_t height, unsigned depth, unsigned type, unsigned interlace)
{
    Bytes header = { .n = 0 };
    put_big(&header, width, 4);
    put_big(&header, height, 4);
    put_byte(&header, depth);
    put_byte(&header, type);
    put_big(&header, interlace, 3);
    put(b, png_mark, 8);
    put_chunk(b, "IHDR", header.at, header.n);
}

/* One stored block. */
static void put_zlib_stored(Bytes *b, const unsigned char *data, size_t n)
{
    put_big(b, 0x7801, 2);
    put_byte(b, 1);
    put_little(b, (uint32_t)n, 2);
    put_little(b, ~(uint32_t)n, 2);
    put(b, data, n);
    put_big(b, png_adler(data, n), 4);
}

typedef struct { unsigned width, height, depth, type; bool interlaced; } Shape;

static const unsigned palette_size = 13;
static unsigned palette(unsigned entry, unsigned k) { return (entry * 19 + k * 87) % 256; }

static unsigned sample_count(unsigned type) { return type == 2 ? 3 : type == 4 ? 2 : type == 6 ? 4 : 1; }
static unsigned sample(const Shape *s, unsigned x, unsigned y, unsigned k)
{
    unsigned v = (x * 7919 + y * 104729 + k * 31337 + 12345) * 2654435761u >> 7, range = 1u << s->depth;
    return v % (s->type == 3 && range > palette_size ? palette_size : range);
}

static double png_expected(const void *context, unsigned x, unsigned y, unsigned k)
{
    const Shape *s = context;
    if (s->type == 3) return from_srgb(palette(sample(s, x, y, 0), k) / 255.0);
    return from_srgb(sample(s, x, y, sample_count(s->type) >= 3 ? k : 0) / (double)((1u << s->depth) - 1));
}

/* Appends the filtered rows of the pixels x0 + i dx, y0 + j dy, each with the next filter. */
static void put_pass(Bytes *b, const Shape *s, unsigned x0, unsigned y0, unsigned dx, unsigned dy)
{
    unsigned char rows[2][128] = { { 0 }, { 0 } };     /* eight zeros before each */
    unsigned channels = sample_count(s->type), j = 0;
    int bpp = (int)(channels * s->depth + 7) / 8;
    for (unsigned y = y0; y < s->height && x0 < s->width; y += dy, j++) {
        unsigned char *row = rows[j % 2] + 8, *above = rows[(j + 1) % 2] + 8;
        unsigned bit = 0, filter = (j + x0 + y0 + s->type + s->depth) % 5;
        memset(row, 0, 120);
        for (unsigned x = x0; x < s->width; x += dx)
            for (unsigned k = 0; k < channels; k++)
                for (unsigned i = s->depth; i-- > 0; bit++) row[bit / 8] |= (unsigned char)((sample(s, x, y, k) >> i & 1) << (7 - bit % 8));
        put_byte(b, filter);
        for (int i = 0; i < (int)(bit + 7) / 8; i++) {
            int left = row[i - bpp], up = above[i], corner = above[i - bpp];
            int guess = filter == 1 ? left : filter == 2 ? up : filter == 3 ? (left + up) / 2 : filter == 4 ? (int)png_paeth(left, up, corner) : 0;
            put_byte(b, (unsigned)(row[i] - guess) & 255);
        }
    }
}

static void put_palette(Bytes *b, unsigned depth)
{
    unsigned char entries[3 * 256];
    unsigned n = 3 * (palette_size < 1u << depth ? palette_size : 1u << depth);
    for (unsigned i = 0; i < n; i++) entries[i] = (unsigned char)palette(i / 3, i % 3);
    put_chunk(b, "PLTE", entries, n);
}

static void put_png(Bytes *b, const Shape *s)
{
    static const unsigned passes[7][4] = { { 0, 0, 8, 8 }, { 4, 0, 8, 8 }, { 0, 4, 4, 8 }, { 2, 0, 4, 4 }, { 0, 2, 2, 4 }, { 1, 0, 2, 2 }, { 0, 1, 1, 2 } };
    static Bytes rows, packed;
    rows.n = packed.n = b->n = 0;
    if (!s->interlaced) put_pass(&rows, s, 0, 0, 1, 1);
    for (unsigned p = 0; s->interlaced && p < 7; p++) put_pass(&rows, s, passes[p][0], passes[p][1], passes[p][2], passes[p][3]);
    put_zlib_stored(&packed, rows.at, rows.n);
    put_header(b, s->width, s->height, s->depth, s->type, s->interlaced);
    put_chunk(b, "gAMA", "\0\0\xb1\x8f", 4);
    if (s->type == 3) put_palette(b, s->depth);
    if (s->type == 0) put_chunk(b, "tRNS", "\0\1", 2);
    if (s->type == 2) put_chunk(b, "tRNS", "\0\1\0\2\0\3", 6);
    if (s->type == 3) put_chunk(b, "tRNS", "\x10\x80", 2);
    put_chunk(b, "IDAT", packed.at, packed.n / 3);
    put_chunk(b, "IDAT", packed.at, 0);
    put_chunk(b, "IDAT", packed.at + packed.n / 3, packed.n - packed.n / 3);
    put_chunk(b, "IEND", "", 0);
}

static void test_png_kinds(void)
{
    static Bytes b;
    for (unsigned type = 0; type < 8; type++)
        for (unsigned depth = 1; depth <= 32; depth++)
            for (unsigned interlaced = 0; interlaced < 2; interlaced++) {
                bool power = (depth & (depth - 1)) == 0 && depth <= 16;
                bool known = type == 0 ? power : type == 3 ? power && depth <= 8 : (type == 2 || type == 4 || type == 6) && (depth == 8 || depth == 16);
                Shape s = { 11, 13, depth, type, interlaced };
                if (!known) {
                    b.n = 0;
                    put_header(&b, 1, 1, depth, type, interlaced);
                    CHECK(refused(b.at, b.n, "no such PNG colour type and bit depth"));
                    continue;
                }
                put_png(&b, &s);
                if (!CHECK(shows(&b, s.width, s.height, png_expected, &s))) printf("type %u, depth %u, interlaced %u\n", type, depth, interlaced);
                CHECK(changes_taken(&b) == 0);
                CHECK(beginnings_taken(&b, 0) == 0);
            }
    /* Sizes at which passes are empty. */
    for (unsigned width = 1; width <= 9; width++)
        for (unsigned height = 1; height <= 9; height++)
            for (unsigned depth = 1; depth <= 8; depth *= 8) {
                Shape s = { width, height, depth, 0, true };
                put_png(&b, &s);
                CHECK(shows(&b, width, height, png_expected, &s));
            }
}

/* A grey picture of 8 bits around a zlib stream. */
static void wrap_zlib(Bytes *b, const unsigned char *zlib, size_t n, unsigned width, unsigned height)
{
    b->n = 0;
    put_header(b, width, height, 8, 0, 0);
    put_chunk(b, "IDAT", zlib, n);
    put_chunk(b, "IEND", "", 0);
}

/* 40 x 12, compressed at level 9 in several ways: with the fixed code; codes of its own; no matches at all; blocks of all kinds. */
static const unsigned char zlib_fixed[] = {
    0x78, 0x01, 0x63, 0x60, 0x00, 0x82, 0xff, 0x40, 0x40, 0x98, 0x96, 0xb3, 0x89, 0x02, 0x31, 0x80, 0x54, 0x05, 0x88, 0x06, 0x52, 0xd3, 0x40, 0x34,
    0x90, 0xda, 0x02, 0xa2, 0x81, 0x14, 0x54, 0xa1, 0x4d, 0x05, 0x58, 0x00, 0x48, 0xc9, 0x81, 0x25, 0xb6, 0xc8, 0x81, 0x35, 0x02, 0x29, 0xb0, 0x06,
    0x20, 0x05, 0x51, 0x08, 0x22, 0xa6, 0xc9, 0x55, 0x80, 0x69, 0x20, 0x05, 0x56, 0x04, 0xa4, 0xc0, 0x9a, 0x81, 0x94, 0x0d, 0xd8, 0xf4, 0x2d, 0x36,
    0x10, 0xd5, 0x36, 0x5b, 0xa2, 0xc0, 0x34, 0x90, 0x02, 0x5b, 0x0f, 0xa4, 0xc0, 0xa6, 0x03, 0x29, 0xb0, 0xa9, 0x40, 0xca, 0x06, 0xa2, 0xa0, 0x02,
    0x42, 0x03, 0x29, 0xb0, 0x04, 0x90, 0x02, 0x9b, 0x0c, 0xa4, 0xc0, 0x1a, 0x80, 0xd4, 0x16, 0x06, 0x86, 0x2d, 0xd3, 0xc0, 0xa6, 0x00, 0x29, 0xb0,
    0x24, 0x90, 0x02, 0x5b, 0x07, 0xa4, 0xc0, 0x8a, 0x80, 0x14, 0xdc, 0xf7, 0x54, 0x0e, 0x1e, 0xe4, 0x20, 0x00, 0x52, 0x60, 0x6b, 0x81, 0x14, 0x58,
    0x13, 0x72, 0xd0, 0x51, 0x3f, 0x78, 0x00, 0x4b, 0xc8, 0x34, 0x08
};
static const unsigned char zlib_dynamic[] = {
    0x78, 0xda, 0xad, 0xd0, 0xc1, 0x11, 0x80, 0x20, 0x0c, 0x05, 0x51, 0x2a, 0xa1, 0x92, 0x54, 0x42, 0x25, 0x54, 0x42, 0x25, 0xe9, 0x4f, 0x37, 0x8b,
    0xe3, 0x70, 0xf3, 0x22, 0x07, 0x9f, 0x23, 0x3f, 0xc9, 0x98, 0xd6, 0x38, 0x17, 0xe7, 0xdb, 0x1e, 0xa3, 0x5e, 0x60, 0x96, 0xb0, 0x4a, 0xc8, 0x12,
    0x9e, 0x60, 0x4c, 0x3f, 0x40, 0xf7, 0x22, 0xbb, 0x85, 0x60, 0x01, 0xec, 0x60, 0x3d, 0x56, 0x9f, 0x0a, 0x86, 0xc0, 0x62, 0x08, 0xbb, 0x67, 0xec,
    0x74, 0xe4, 0x50, 0x70, 0x3c, 0xd8, 0x1d, 0xec, 0x0a, 0xb1, 0x03, 0x73, 0x0b, 0x5e, 0x80, 0x9d, 0xc1, 0x02, 0xc8, 0xd6, 0x72, 0xd9, 0x05, 0xbc,
    0x04, 0xc7, 0x81, 0x21, 0x78, 0xff, 0xfe, 0xe7, 0xf5, 0x9c, 0x2b, 0x00, 0xc7, 0x82, 0x45, 0xe7, 0xea, 0xfe, 0x5f, 0xcf, 0x0d, 0x4b, 0xc8, 0x34,
    0x08
};
static const unsigned char zlib_huffman_only[] = {
    0x78, 0x01, 0x05, 0xc1, 0x81, 0x00, 0x00, 0x40, 0x08, 0x04, 0xb0, 0x23, 0x89, 0x24, 0x92, 0x48, 0x22, 0x89, 0xe4, 0xfd, 0xf6, 0x5b, 0x92, 0x04,
    0x92, 0x04, 0x92, 0x04, 0x92, 0x04, 0x92, 0x04, 0x92, 0xea, 0x81, 0xea, 0x59, 0xe8, 0xd9, 0x83, 0xd9, 0x7b, 0xb0, 0xf7, 0x02, 0x49, 0xef, 0x83,
    0xde, 0x57, 0xb0, 0xaf, 0x06, 0x5e, 0xcd, 0x41, 0xcd, 0x05, 0x02, 0x57, 0x1b, 0xa8, 0xcd, 0xc0, 0x66, 0x1e, 0x64, 0x5e, 0xc3, 0xbc, 0xbe, 0x40,
    0xbf, 0x09, 0xbc, 0xc9, 0xc2, 0x64, 0x0b, 0xb2, 0x75, 0xb0, 0x75, 0x1d, 0x78, 0xdb, 0x81, 0xed, 0x1c, 0x74, 0x6e, 0x20, 0x37, 0x05, 0x37, 0xf5,
    0x92, 0x77, 0x0b, 0xef, 0x76, 0xe0, 0x76, 0x1a, 0x76, 0xba, 0x60, 0xba, 0x02, 0x49, 0x12, 0x48, 0x12, 0x48, 0x12, 0x48, 0x12, 0x48, 0x12, 0x48,
    0xaa, 0x07, 0xaa, 0x67, 0xa1, 0x67, 0x0f, 0x66, 0xef, 0xc1, 0xde, 0x0b, 0x04, 0x6a, 0x2e, 0x30, 0x97, 0x86, 0x4b, 0x2f, 0xa4, 0xf7, 0x41, 0xef,
    0xab, 0xc0, 0xd5, 0x06, 0x6a, 0x33, 0xb0, 0x99, 0x07, 0x99, 0xd7, 0x30, 0xaf, 0x2f, 0xd0, 0x6f, 0x02, 0x6f, 0xb2, 0x30, 0xd9, 0x82, 0x6c, 0x1d,
    0x6c, 0x5d, 0x7f, 0x4b, 0xc8, 0x34, 0x08
};
static const unsigned char zlib_mixed[] = {
    0x78, 0xda, 0x62, 0x60, 0x00, 0x82, 0xff, 0x40, 0x40, 0x98, 0x96, 0xb3, 0x89, 0x02, 0x31, 0x80, 0x54, 0x05, 0x88, 0x06, 0x52, 0xd3, 0x40, 0x34,
    0x90, 0xda, 0x02, 0xa2, 0x81, 0x14, 0x54, 0xa1, 0x4d, 0x05, 0x58, 0x00, 0x48, 0xc9, 0x81, 0x25, 0x00, 0x00, 0x00, 0x00, 0xff, 0xff, 0x24, 0xcd,
    0x41, 0x01, 0x00, 0x30, 0x08, 0xc3, 0x40, 0x27, 0x28, 0x41, 0xc9, 0x94, 0x4c, 0xc9, 0x94, 0x54, 0xe0, 0x42, 0xf8, 0x70, 0x9f, 0xb6, 0xa4, 0x2c,
    0x82, 0x05, 0xd8, 0xe0, 0x9c, 0x57, 0x57, 0xc1, 0x10, 0x58, 0x86, 0x76, 0x3d, 0xbd, 0xe9, 0xce, 0x51, 0xf0, 0x3d, 0xb8, 0x0e, 0xb3, 0xfa, 0x01,
    0x00, 0x00, 0xff, 0xff, 0x34, 0xcc, 0x51, 0x11, 0x00, 0x30, 0x08, 0x02, 0x50, 0x92, 0x2c, 0x89, 0x49, 0x4c, 0x62, 0x12, 0x93, 0xd8, 0xcf, 0x01,
    0xbb, 0xf1, 0xf3, 0xbc, 0x13, 0xdd, 0x3a, 0x1d, 0x58, 0x66, 0xea, 0x49, 0x5a, 0x92, 0x94, 0xe4, 0x48, 0x32, 0xc0, 0x74, 0xb9, 0xdc, 0xe5, 0x25,
    0x09, 0x1f, 0x65, 0xb8, 0x44, 0xfc, 0x04, 0xca, 0x1f, 0xae, 0x00, 0x7d, 0xd0, 0x41, 0x01, 0x00, 0x21, 0x0c, 0x03, 0x41, 0x94, 0xa0, 0x04, 0x25,
    0x55, 0x82, 0x92, 0x2a, 0xa9, 0x40, 0xf6, 0x36, 0xff, 0x7b, 0xcd, 0x27, 0x4d, 0x29, 0xff, 0xee, 0x63, 0x13, 0xd8, 0x0c, 0xae, 0x87, 0xb1, 0xb9,
    0x27, 0x41, 0x43, 0xd5, 0x0a, 0xae, 0x05, 0x87, 0xc0, 0x30, 0x64, 0x7f, 0xef, 0x9b, 0x81, 0xbb, 0x6c, 0x07, 0x03, 0xe0, 0x20, 0xa4, 0xe9, 0x4c,
    0xe5, 0xfa, 0x5a, 0x36, 0x81, 0x87, 0x80, 0xcf, 0xf8, 0xbe, 0xe7, 0x01, 0x4b, 0xc8, 0x34, 0x08
};

static double stream_expected(const void *context, unsigned x, unsigned y, unsigned k)
{
    (void)context, (void)k;
    return from_srgb(((x / 4 + y / 3) % 2 ? 255 : x * y % 7 * 30) / 255.0);
}

static void test_png_streams(void)
{
    static const struct { const unsigned char *at; size_t n; } streams[] = {
        { zlib_fixed, sizeof zlib_fixed }, { zlib_dynamic, sizeof zlib_dynamic }, { zlib_huffman_only, sizeof zlib_huffman_only },
        { zlib_mixed, sizeof zlib_mixed }
    };
    static Bytes b;
    for (size_t i = 0; i < sizeof streams / sizeof *streams; i++) {
        unsigned char zlib[256];
        size_t n = streams[i].n;
        memcpy(zlib, streams[i].at, n);
        wrap_zlib(&b, zlib, n, 40, 12);
        CHECK(shows(&b, 40, 12, stream_expected, NULL));
        CHECK(changes_taken(&b) == 0);
        wrap_zlib(&b, zlib, n, 40, 11);
        CHECK(refused(b.at, b.n, "more than the picture"));
        wrap_zlib(&b, zlib, n, 40, 13);
        CHECK(refused(b.at, b.n, "less than the picture"));
        wrap_zlib(&b, zlib, n, 65535, 4096);
        CHECK(refused(b.at, b.n, "ends too early"));
        for (size_t cut = 0; cut < n; cut++) {
            wrap_zlib(&b, zlib, cut, 40, 12);
            CHECK(refused(b.at, b.n, "compressed data ends too early"));
        }
        /* Below good chunk checksums only zlib's own finds the fault. Spare bits, and others that come to the same, may change. */
        int wrong = 0;
        for (size_t at = 0; at < n; at++) {
            for (unsigned bit = 0; bit < 8; bit++) {
                Report report;
                zlib[at] ^= (unsigned char)(1 << bit);
                wrap_zlib(&b, zlib, n, 40, 12);
                Image *image = decode(b.at, b.n, &report);
                for (unsigned j = 0; image && j < 40 * 12; j++)
                    wrong += !(fabs((double)image->rgb[3 * j] - stream_expected(NULL, j % 40, j / 40, 0)) <= 1e-6);
                image_free(image);
                zlib[at] ^= (unsigned char)(1 << bit);
            }
        }
        CHECK(wrong == 0);
        zlib[n - 1] ^= 1;
        wrap_zlib(&b, zlib, n, 40, 12);
        CHECK(refused(b.at, b.n, "compressed data's checksum is wrong"));
    }
}

/* Deflate by hand: "value:bits" lowest bit first, Huffman codes highest bit first as a string of 0 and 1. Spaces separate. */
static void put_deflate(Bytes *b, const char *text)
{
    unsigned held = 0, byte = 0;
    put_big(b, 0x7801, 2);
    while (*text) {
        char *end;
        unsigned long value = strtoul(text, &end, 10), bits = *end == ':' ? strtoul(end + 1, &end, 10) : 0;
        bool number = memchr(text, ':', (size_t)(end - text)) != NULL;
        for (size_t i = 0; i < (number ? bits : (size_t)(end - text)); i++) {
            byte |= (unsigned)(number ? value >> i & 1 : text[i] == '1') << held;
            if (++held == 8) {
                put_byte(b, byte);
                held = byte = 0;
            }
        }
        text = end + strspn(end, " ");
    }
    if (held) put_byte(b, byte);
}

static bool deflate_refused(const char *text, const char *error)
{
    static Bytes zlib, b;
    zlib.n = 0;
    put_deflate(&zlib, text);
    put_text(&zlib, "more than enough of what comes after");
    wrap_zlib(&b, zlib.at, zlib.n, 3, 1);
    return refused(b.at, b.n, error);
}

static double black(const void *context, unsigned x, unsigned y, unsigned k)
{
    (void)context, (void)x, (void)y, (void)k;
    return 0;
}

static void test_png_deflate(void)
{
    static Bytes zlib, b;
    /* Fixed code: 00110000 is byte 0, 0000001 a match of 3, 00000 distance 1, 0000000 the end. */
    put_deflate(&zlib, "1:1 1:2 00110000 0000001 00000 0000000");
    put_big(&zlib, png_adler((const unsigned char *)"\0\0\0", 4), 4);
    wrap_zlib(&b, zlib.at, zlib.n, 3, 1);
    CHECK(shows(&b, 3, 1, black, NULL));

    CHECK(deflate_refused("1:1 3:2", "broken compressed data"));                                       /* no such block */
    CHECK(deflate_refused("1:1 0:2 0:5 4:16 4:16", "broken compressed data"));                         /* length not repeated inverted */
    CHECK(deflate_refused("1:1 1:2 00110000 0000001 00001 0000000", "broken compressed data"));        /* distance 2 after one byte */
    CHECK(deflate_refused("1:1 1:2 00110000 0000001 11110 0000000", "broken compressed data"));        /* distance code 30 */
    CHECK(deflate_refused("1:1 1:2 00110000 11000110 00000 0000000", "broken compressed data"));       /* literal code 286 */
    CHECK(deflate_refused("1:1 1:2 00110000 0000010 00000 0000000", "more than the picture"));         /* 1 + 4 bytes */
    CHECK(deflate_refused("1:1 1:2 00110000 00110000 00110000 00110000 00110000", "more than the picture"));
    CHECK(deflate_refused("1:1 1:2 00110000 00110000 0000000", "less than the picture"));
    CHECK(deflate_refused("1:1 0:2 0:5 5:16 65530:16", "more than the picture"));
    CHECK(deflate_refused("1:1 2:2 0:5 0:5 0:4 0:3 0:3 0:3 0:3", "broken compressed data"));           /* no code for lengths */
    CHECK(deflate_refused("1:1 2:2 0:5 0:5 0:4 1:3 0:3 1:3 0:3 0", "broken compressed data"));         /* repeat what? */
    CHECK(deflate_refused("1:1 2:2 0:5 0:5 0:4 1:3 0:3 1:3 0:3 1 127:7 1 127:7", "broken compressed data"));           /* 276 lengths of 258 */
    CHECK(deflate_refused("1:1 2:2 0:5 0:5 0:4 0:3 0:3 1:3 0:3 0 127:7 0 109:7 1", "broken compressed data"));         /* nothing has a code */

    /* Codes of its own: 0 is a length of 1 bit, 1 a run of zeros. Literal 0 and the end have one bit, then come 29 lengths of no match
     * and 30 distances. Then that with 287 literals, 31 distances, one length too many, and two or three distances of one bit. */
#define OWN(literals, distances, rest) "1:1 2:2 " literals ":5 " distances ":5 14:4 0:6 1:3 0:42 1:3 0 1 127:7 1 106:7 0 " rest " 0000 1"
    static const char *const good[] = { OWN("29", "29", "1 48:7"), OWN("29", "29", "1 18:7 0 0 1 17:7") };
    for (unsigned i = 0; i < 2; i++) {
        zlib.n = 0;
        put_deflate(&zlib, good[i]);
        put_big(&zlib, png_adler((const unsigned char *)"\0\0\0", 4), 4);
        wrap_zlib(&b, zlib.at, zlib.n, 3, 1);
        CHECK(shows(&b, 3, 1, black, NULL));
    }
    CHECK(deflate_refused(OWN("30", "29", "1 49:7"), "broken compressed data"));
    CHECK(deflate_refused(OWN("29", "30", "1 49:7"), "broken compressed data"));
    CHECK(deflate_refused(OWN("29", "29", "1 49:7"), "broken compressed data"));
    CHECK(deflate_refused(OWN("29", "29", "1 18:7 0 0 0 1 16:7"), "broken compressed data"));
#undef OWN

    /* Bad zlib headers: another method, a window too large, a preset dictionary, a wrong check. */
    static const unsigned heads[] = { 0x7709, 0x881c, 0x7820, 0x7802 };
    for (unsigned i = 0; i < 4; i++) {
        zlib.at[0] = (unsigned char)(heads[i] >> 8);
        zlib.at[1] = (unsigned char)heads[i];
        wrap_zlib(&b, zlib.at, zlib.n, 3, 1);
        CHECK(refused(b.at, b.n, "not a zlib stream that PNG allows"));
    }
}

static void test_png_chunks(void)
{
    static Bytes b, zlib;
    static const unsigned char rows[] = { 0, 5, 6, 7 };
    put_zlib_stored(&zlib, rows, sizeof rows);

    put(&b, png_mark, 8);
    put_chunk(&b, "IDAT", zlib.at, zlib.n);
    CHECK(refused(b.at, b.n, "must begin with its header"));
    b.n = 0;
    put_header(&b, 3, 1, 8, 0, 0);
    put(&b, b.at + 8, 25);
    CHECK(refused(b.at, b.n, "must begin with its header"));
    b.n = 8;
    put_chunk(&b, "IHDR", "\0\0\0\1\0\0\0\1\10", 9);
    CHECK(refused(b.at, b.n, "broken PNG header"));
    b.n = 0;
    put_header(&b, 3, 1, 8, 0, 0);
    put_chunk(&b, "ABCD", "", 0);
    CHECK(refused(b.at, b.n, "unknown PNG chunk"));
    b.n = 0;
    put_header(&b, 3, 1, 8, 0, 0);
    put_chunk(&b, "IEND", "", 0);
    CHECK(refused(b.at, b.n, "ends too early"));
    b.n = 0;
    put_header(&b, 3, 1, 8, 0, 0);
    put_big(&b, 0xfffffff4, 4);
    put_text(&b, "IDAT and so on");
    CHECK(refused(b.at, b.n, "ends too early"));
    b.n = 0;
    put_header(&b, 3, 1, 8, 0, 2);
    CHECK(refused(b.at, b.n, "interlace method"));
    b.n = 0;
    put_header(&b, 3, 1, 8, 0, 0x100);
    CHECK(refused(b.at, b.n, "filter or interlace method"));
    b.n = 0;
    put_header(&b, 3, 1, 8, 0, 0x10000);
    CHECK(refused(b.at, b.n, "unknown PNG compression"));

    b.n = 0;
    put_header(&b, 3, 1, 8, 3, 0);
    put_chunk(&b, "IDAT", zlib.at, zlib.n);
    put_chunk(&b, "IEND", "", 0);
    CHECK(refused(b.at, b.n, "not in the palette"));
    b.n = 0;
    put_header(&b, 3, 1, 8, 3, 0);
    put_chunk(&b, "PLTE", rows, 4);
    CHECK(refused(b.at, b.n, "broken PNG palette"));
    b.n = 0;
    put_header(&b, 3, 1, 8, 3, 0);
    put_chunk(&b, "PLTE", b.at, 0);
    CHECK(refused(b.at, b.n, "broken PNG palette"));
    b.n = 0;
    put_header(&b, 3, 1, 8, 3, 0);
    put_chunk(&b, "PLTE", zlib.at, 257 * 3);
    CHECK(refused(b.at, b.n, "broken PNG palette"));

    zlib.n = 0;
    put_zlib_stored(&zlib, (const unsigned char *)"\5\1\2\3", 4);
    wrap_zlib(&b, zlib.at, zlib.n, 3, 1);
    CHECK(refused(b.at, b.n, "unknown PNG filter"));

    /* A small file may not claim much, nor any the impossible. */
    static const uint32_t sizes[][2] = { { 16384, 16384 }, { 65536, 1 }, { 1, 65536 }, { 65535, 65535 }, { 0xffffffff, 0xffffffff }, { 0, 1 }, { 1, 0 } };
    static const char *const errors[] = { "ends too early", "too many", "too many", "too many", "too many", "no pixels", "no pixels" };
    for (unsigned i = 0; i < sizeof sizes / sizeof *sizes; i++) {
        wrap_zlib(&b, zlib.at, zlib.n, sizes[i][0], sizes[i][1]);
        CHECK(refused(b.at, b.n, errors[i]));
    }
}

/* ---- PFM, PPM, PGM ---- */

typedef struct { unsigned width, channels, maxval; const unsigned *samples; } Samples;

static double samples_expected(const void *context, unsigned x, unsigned y, unsigned k)
{
    const Samples *s = context;
    return from_srgb(s->samples[(y * s->width + x) * s->channels + (s->channels == 3 ? k : 0)] / (double)s->maxval);
}

static void test_pnm(void)
{
    static const unsigned samples[12] = { 0, 1, 2, 3, 100, 255, 7, 254, 128, 64, 32, 116 };
    static const char *const texts[2] = { "P2#c\n2 #a b\n 3\t255 \n0 1 2\r\n3 100 255", "P3 2 2 255\n0 1 2 3 100 255 7 254 128 64 32 116" };
    static Bytes b;
    for (unsigned colour = 0; colour < 2; colour++) {
        Samples s = { 2, colour ? 3 : 1, 255, samples };
        unsigned height = colour ? 2 : 3, n = colour ? 12 : 6;
        b.n = 0;
        put_text(&b, texts[colour]);
        CHECK(shows(&b, 2, height, samples_expected, &s));
        CHECK(beginnings_taken(&b, 0) == 2);                   /* the last sample of two or three digits, cut: no one can tell */
        for (unsigned bytes = 1; bytes <= 2; bytes++) {
            static const unsigned maxvals[2][3] = { { 255, 254 + 1, 255 }, { 256, 1000, 65535 } };
            for (unsigned m = 0; m < 3; m++) {
                char head[40];
                s.maxval = maxvals[bytes - 1][m];
                snprintf(head, sizeof head, "P%c\n# a comment\n2 %u\n%u\n", colour ? '6' : '5', height, s.maxval);
                b.n = 0;
                put_text(&b, head);
                for (unsigned i = 0; i < n; i++) put_big(&b, samples[i], bytes);
                CHECK(shows(&b, 2, height, samples_expected, &s));
                CHECK(beginnings_taken(&b, 0) == 0);
            }
        }
    }
    static const unsigned wide[3] = { 0xfffe, 0x0102, 0x8000 };
    Samples s = { 1, 3, 65535, wide };
    b.n = 0;
    put_text(&b, "P6 1 1 65535\n");
    for (unsigned i = 0; i < 3; i++) put_big(&b, wide[i], 2);
    CHECK(shows(&b, 1, 1, samples_expected, &s));

    CHECK(text_refused("P6 1 1 100\n\1\2\x65", "larger than the header allows"));
    CHECK(text_refused("P2 2 1 100\n100 101", "larger than the header allows"));
    CHECK(text_refused("P2 2 1 100\n99999999999999999999999999 1", "larger than the header allows"));
    CHECK(text_refused("P2 2 1 100\n1 x", "not a number"));
    CHECK(text_refused("P2 2 1 100\n1 2x", "not a number"));
    CHECK(text_refused("P2 2 1 100\n1  ", "ends before"));
    CHECK(text_refused("P2 2 1 100\n1 -2", "not a number"));
    CHECK(text_refused("P5 1 1 0\n1", "1 to 65535"));
    CHECK(text_refused("P5 1 1 65536\n111", "1 to 65535"));
    CHECK(text_refused("P5 0 1 255\n1", "no pixels"));
    CHECK(text_refused("P5 65536 1 255\n1", "too many"));
    CHECK(text_refused("P5 16384 16385 255\n1", "too many"));
    CHECK(text_refused("P5 18446744073709551617 1 255\n1", "too many"));
    CHECK(text_refused("P6 16384 16384 255\n1", "ends before"));
    CHECK(text_refused("P3 16384 16384 255\n1", "ends before"));
    CHECK(text_refused("P5 -1 1 255\n1", "broken PPM or PGM header"));
    CHECK(text_refused("P5 1 1.5 255\n1", "broken PPM or PGM header"));
    CHECK(text_refused("P5 1 1 255x1", "broken PPM or PGM header"));
    CHECK(text_refused("P5 1 1 #255\n", "broken PPM or PGM header"));
    CHECK(text_refused("P4 1 1 \n1", "not a PFM, PPM, PGM, PNG or TGA picture"));
    CHECK(text_refused("P61 1 255\n111", "not a PFM, PPM, PGM, PNG or TGA picture"));
    CHECK(text_refused("# a scene\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "not a PFM, PPM, PGM, PNG or TGA picture"));
    CHECK(text_refused("", "the file is empty"));
}

static void test_pfm(void)
{
    static const float values[6] = { 0.5f, -2.0f, INFINITY, 1e-40f, 3.0f, NAN };               /* top row, bottom row */
    static const char *const scales[] = { "1", "-1.0", "+2.5e3", "-.5", "-3.E-2", "001.", "-1e-400" };
    static Bytes b;
    Report report;
    for (unsigned i = 0; i < sizeof scales / sizeof *scales; i++) {
        for (unsigned channels = 1; channels <= 3; channels += 2) {
            unsigned width = 3 / channels;
            char head[40];
            snprintf(head, sizeof head, "P%c\n%u 2\n%s\n", channels == 3 ? 'F' : 'f', width, scales[i]);
            b.n = 0;
            put_text(&b, head);
            for (unsigned k = 0; k < 6; k++) {
                uint32_t bits;
                memcpy(&bits, &values[(k + 3) % 6], 4);
                if (scales[i][0] == '-') put_little(&b, bits, 4);
                else put_big(&b, bits, 4);
            }
            Image *image = decode(b.at, b.n, &report);
            if (!CHECK(image && image->width == width && image->height == 2)) continue;
            int wrong = 0;
            for (unsigned k = 0; k < width * 6; k++) wrong += memcmp(&image->rgb[k], &values[channels == 3 ? k : k / 3], 4) != 0;
            CHECK(wrong == 0);
            CHECK(beginnings_taken(&b, 0) == 0);
            image_free(image);
        }
    }
    static const char *const broken[] = { "0", "-0.0", "x", "-", "1e", "1e+", "nan", "inf", "1,5", "1.0.0", "0x1", ".", "e5" };
    for (unsigned i = 0; i < sizeof broken / sizeof *broken; i++) {
        char text[40];
        snprintf(text, sizeof text, "PF 1 1 %s\n123456789012", broken[i]);
        CHECK(text_refused(text, "broken PFM header"));
    }
    CHECK(text_refused("PF 1 -1 -1\n123456789012", "broken PFM header"));
    CHECK(text_refused("PF 1 1 -1", "broken PFM header"));
    CHECK(text_refused("PF 1 1 -1\n12345678901", "ends before"));
    CHECK(text_refused("Pf 1 1 -1\n123", "ends before"));
    CHECK(text_refused("PF 16384 16384 -1\n12345678901", "ends before"));
    CHECK(text_refused("PF 0 0 -1\n", "no pixels"));
    CHECK(text_refused("PF 65536 1 -1\n", "too many"));
}

/* ---- TGA ---- */

typedef struct { unsigned kind, depth, map_depth, descriptor; bool rle; } TgaShape;
enum { TGA_WIDTH = 5, TGA_HEIGHT = 4, TGA_MAP_FIRST = 3, TGA_MAP_SIZE = 9 };

/* What is stored for a pixel, or for an entry of the palette. Pixels come in runs, that some may be packed. */
static uint32_t tga_value(const TgaShape *t, unsigned x, unsigned y)
{
    unsigned run = (y * TGA_WIDTH + x) / 3;
    return t->kind == 1 ? TGA_MAP_FIRST + run % TGA_MAP_SIZE : (run * run + 77) * 2654435761u;
}
static uint32_t tga_entry(unsigned entry) { return (entry + 5) * 2246822519u; }

static double tga_expected(const void *context, unsigned x, unsigned y, unsigned k)
{
    const TgaShape *t = context;
    uint32_t value = tga_value(t, x, y);
    unsigned depth = t->depth;
    if (t->kind == 3) return from_srgb((value & 255) / 255.0);
    if (t->kind == 1) {
        value = tga_entry(value - TGA_MAP_FIRST);
        depth = t->map_depth;
    }
    return depth <= 16 ? from_srgb((value >> (10 - 5 * k) & 31) / 31.0) : from_srgb((value >> (16 - 8 * k) & 255) / 255.0);
}

static void put_tga_header(Bytes *b, const TgaShape *t, unsigned width, unsigned height)
{
    b->n = 0;
    put_byte(b, 3);
    put_byte(b, t->kind == 1);
    put_byte(b, t->kind + (t->rle ? 8 : 0));
    put_little(b, t->kind == 1 ? TGA_MAP_FIRST : 0, 2);
    put_little(b, t->kind == 1 ? TGA_MAP_SIZE : 0, 2);
    put_byte(b, t->map_depth);
    put_little(b, 0x00050006, 4);
    put_little(b, width, 2);
    put_little(b, height, 2);
    put_byte(b, t->depth);
    put_byte(b, t->descriptor);
    put_text(b, "id.");
    for (unsigned i = 0; t->kind == 1 && i < TGA_MAP_SIZE; i++) put_little(b, tga_entry(i), (t->map_depth + 7) / 8);
}

static void put_tga(Bytes *b, const TgaShape *t)
{
    uint32_t values[TGA_WIDTH * TGA_HEIGHT];
    unsigned bytes = (t->depth + 7) / 8, n = TGA_WIDTH * TGA_HEIGHT;
    for (unsigned i = 0; i < n; i++) {
        unsigned x = i % TGA_WIDTH, y = i / TGA_WIDTH;
        values[i] = tga_value(t, t->descriptor & 16 ? TGA_WIDTH - 1 - x : x, t->descriptor & 32 ? y : TGA_HEIGHT - 1 - y);
    }
    put_tga_header(b, t, TGA_WIDTH, TGA_HEIGHT);
    for (unsigned i = 0, run; i < n; i += run) {
        for (run = 1; i + run < n && values[i + run] == values[i];) run++;
        bool same = t->rle && run > 1;
        if (!t->rle) run = 1;
        else if (!same) run = i + 4 < n ? 4 : n - i;           /* a packet of single pixels may hold equal ones too */
        if (t->rle) put_byte(b, (same ? 128 : 0) + run - 1);
        for (unsigned j = 0; j < (same ? 1 : run); j++) put_little(b, values[i + j], bytes);
    }
}

static void test_tga(void)
{
    static Bytes b;
    for (unsigned kind = 0; kind < 8; kind++)
        for (unsigned depth = 1; depth <= 64; depth++)
            for (unsigned map_depth = 15; map_depth <= (kind == 1 ? 32 : 15); map_depth++)
                for (unsigned flips = 0; flips < 8; flips++) {
                    TgaShape t = { kind, depth, kind == 1 ? map_depth : 0, (flips & 3) << 4, flips & 4 };
                    bool colour = depth == 15 || depth == 16 || depth == 24 || depth == 32;
                    bool map_colour = map_depth == 15 || map_depth == 16 || map_depth == 24 || map_depth == 32;
                    bool grey = depth == 8 || depth == 16;
                    if (kind == 1 ? map_colour && grey : kind == 2 ? colour : kind == 3 && grey) {
                        put_tga(&b, &t);
                        if (!CHECK(shows(&b, TGA_WIDTH, TGA_HEIGHT, tga_expected, &t)))
                            printf("kind %u, depth %u, palette depth %u, descriptor %u, rle %d\n", kind, depth, map_depth, t.descriptor, t.rle);
                        CHECK(beginnings_taken(&b, 0) == 0);
                    } else if (flips == 0) {
                        put_tga_header(&b, &t, 1, 1);
                        b.n += 1000;
                        CHECK(refused(b.at, b.n, "not a PFM, PPM, PGM, PNG or TGA picture"));
                    }
                }
    /* A palette before true colour is passed over. */
    TgaShape t = { 1, 24, 24, 0, false }, plain = { 2, 24, 0, 0, false };
    put_tga_header(&b, &t, 1, 1);
    b.at[2] = 2;
    put_little(&b, tga_value(&plain, 0, 0), 3);
    CHECK(shows(&b, 1, 1, tga_expected, &plain));
    CHECK(beginnings_taken(&b, 0) == 0);

    /* No palette, whatever its size is said to be. */
    put_tga_header(&b, &plain, 1, 1);
    b.at[5] = 9;
    b.at[7] = 24;
    put_little(&b, tga_value(&plain, 0, 0), 3);
    CHECK(shows(&b, 1, 1, tga_expected, &plain));

    static const unsigned indices[] = { TGA_MAP_FIRST - 1, TGA_MAP_FIRST + TGA_MAP_SIZE };
    for (unsigned i = 0; i < 2; i++) {
        t = (TgaShape){ 1, 8, 24, 0, false };
        put_tga_header(&b, &t, 1, 1);
        put_byte(&b, indices[i]);
        CHECK(refused(b.at, b.n, "not in the palette"));
    }
    t = (TgaShape){ 2, 24, 0, 64, false };
    put_tga_header(&b, &t, 1, 1);
    put_little(&b, 0, 3);
    CHECK(refused(b.at, b.n, "not a PFM"));
    for (unsigned rle = 0; rle < 2; rle++) {
        t = (TgaShape){ 2, 24, 0, 0, rle };
        put_tga_header(&b, &t, 0, 1);
        CHECK(refused(b.at, b.n, "no pixels"));
        put_tga_header(&b, &t, 65535, 65535);
        CHECK(refused(b.at, b.n, "too many"));
        put_tga_header(&b, &t, 16384, 16384);
        b.n += 1000;
        CHECK(refused(b.at, b.n, "ends before"));
    }
}

/* ---- Files ---- */

static size_t load(const char *name, Bytes *b)
{
    FILE *file = fopen(folder_path(name), "rb");
    b->n = file ? fread(b->at, 1, sizeof b->at, file) : 0;
    if (file) fclose(file);
    return b->n;
}

static int files_in_folder(void) { return folder_entries(folder(), false); }

/* Written under that name and read back; NULL if either fails. */
static Image *round_trip(const Image *image, const char *name, double ev)
{
    Report report = { .warnings = stdout };
    Image *again = NULL;
    if (!image_write(image, folder_path(name), ev, &report) || !(again = image_read(folder_path(name), &report))) printf("%s\n", report.error);
    else if (again->width != image->width || again->height != image->height) {
        image_free(again);
        again = NULL;
    }
    return again;
}

static uint32_t random_bits(uint32_t *state) { return *state = *state * 1664525u + 1013904223u; }
static double random_unit(uint32_t *state) { return (random_bits(state) >> 8) / 16777216.0; }

static void test_write_pfm(void)
{
    static Bytes b;
    Image *image = image_new(7, 5);
    uint32_t state = 1;
    for (unsigned i = 0; i < 7 * 5 * 3; i++) {
        uint32_t bits = random_bits(&state);                    /* any float there is: denormals, infinities and signs too */
        memcpy(&image->rgb[i], &bits, 4);
    }
    image->rgb[0] = NAN;
    image->rgb[1] = INFINITY;
    image->rgb[2] = -0.0f;
    image->rgb[3 * 7 * 4] = 1.5f;                               /* bottom left: first in the file, 0x3fc00000 */
    Image *again = round_trip(image, "a.pfm", 3);               /* no exposure */
    CHECK(again && memcmp(again->rgb, image->rgb, sizeof(float) * 7 * 5 * 3) == 0);
    static const char head[] = "PF\n7 5\n-1.0\n\0\0\xc0\x3f";
    CHECK(load("a.pfm", &b) == sizeof head - 5 + 7 * 5 * 12 && memcmp(b.at, head, sizeof head - 1) == 0);
    image_free(again);
    image_free(image);
}

static void test_write_8_bits(void)
{
    static Bytes b;
    static const char *const names[] = { "a.ppm", "a.png" };
    static const struct { double linear; int byte; } special[] = {
        { NAN, 0 }, { -NAN, 0 }, { INFINITY, 255 }, { -INFINITY, 0 }, { -1, 0 }, { -0.0, 0 }, { 1e30, 255 }, { 1, 255 }, { 1.01, 255 }, { 1e-40, 0 },
        { 0.18, 118 }, { 0.5, 188 }, { 0.0031308, 10 }, { 0.0031309, 10 }
    };
    enum { SPECIAL = sizeof special / sizeof *special };
    for (unsigned f = 0; f < 2; f++) {
        /* Each byte comes back from its own value, and from the ends of the interval that rounds to it. */
        Image *image = image_new(256, 1);
        for (unsigned i = 0; i < 256; i++)
            for (unsigned k = 0; k < 3; k++) image->rgb[3 * i + k] = (float)from_srgb((i + 0.499 * ((int)k - 1)) / 255);
        Image *again = round_trip(image, names[f], 0);
        int wrong = 0;
        for (unsigned i = 0; again && i < 768; i++) wrong += !(fabs((double)again->rgb[i] - from_srgb(i / 3 / 255.0)) <= 1e-6);
        CHECK(again && wrong == 0);
        image_free(again);

        /* Exposure: a quarter at +2 is the same. */
        for (unsigned i = 0; i < 768; i++) image->rgb[i] *= 0.25f;
        again = round_trip(image, names[f], 2);
        wrong = 0;
        for (unsigned i = 0; again && i < 768; i++) wrong += !(fabs((double)again->rgb[i] - from_srgb(i / 3 / 255.0)) <= 1e-6);
        CHECK(again && wrong == 0);
        image_free(again);
        image_free(image);

        image = image_new(SPECIAL, 1);
        for (unsigned i = 0; i < SPECIAL; i++)
            for (unsigned k = 0; k < 3; k++) image->rgb[3 * i + k] = (float)special[i].linear;
        again = round_trip(image, names[f], 0);
        for (unsigned i = 0; again && i < SPECIAL * 3; i++) CHECK_NEAR(255 * to_srgb((double)again->rgb[i]), special[i / 3].byte, 1e-4);
        CHECK(again);
        image_free(again);
        again = round_trip(image, names[f], 2000);              /* 2^2000 is infinite; 0 times that must not be white */
        CHECK(again && again->rgb[0] <= 0 && again->rgb[3 * 5] <= 0 && again->rgb[3 * 10] >= 1);
        image_free(again);
        image_free(image);
    }
    /* Rows from top to bottom, red first. */
    Image *image = image_new(1, 2);
    image->rgb[0] = image->rgb[4] = image->rgb[5] = 1;
    image_free(round_trip(image, "b.PPM", 0));
    static const unsigned char ppm[] = "P6\n1 2\n255\n\xff\0\0\0\xff\xff";
    CHECK(load("b.PPM", &b) == sizeof ppm - 1 && memcmp(b.at, ppm, sizeof ppm - 1) == 0);
    image_free(image);
}

/* Pictures that lead deflate into its corners, each written as PNG and compared with what PPM gives. */
static void test_write_png(void)
{
    static const unsigned sizes[][2] = { { 1, 1 }, { 1, 700 }, { 700, 1 }, { 2, 3 }, { 300, 200 } };
    enum { EMPTY, GRADIENT, NOISE, SKEWED, TILES, KINDS };
    for (unsigned i = 0; i < sizeof sizes / sizeof *sizes; i++) {
        for (unsigned kind = 0; kind < KINDS; kind++) {
            Image *image = image_new(sizes[i][0], sizes[i][1]);
            uint32_t state = 7;
            unsigned n = sizes[i][0] * sizes[i][1] * 3;
            for (unsigned j = 0; kind != EMPTY && j < n; j++) {
                unsigned x = j / 3 % sizes[i][0], y = j / 3 / sizes[i][0];
                double u = random_unit(&state);
                double byte = kind == GRADIENT ? (x + 2 * y) % 256 : kind == NOISE ? floor(256 * u)
                    : kind == SKEWED ? floor(-log2(1 - u)) * 7              /* each half as frequent as the one before: a deep code */
                    : (x / 40 + y / 40) % 2 * 40 + x % 40 * (y % 40) % 256;
                image->rgb[j] = (float)from_srgb(byte / 255);
            }
            Image *png = round_trip(image, "c.png", 0), *ppm = round_trip(image, "c.ppm", 0);
            if (!CHECK(png && ppm && memcmp(png->rgb, ppm->rgb, n * sizeof(float)) == 0)) printf("%u x %u, kind %u\n", sizes[i][0], sizes[i][1], kind);
            if ((kind == EMPTY || kind == GRADIENT) && n > 100000) {
                static Bytes b;
                CHECK(load("c.png", &b) < 2000);                            /* it does compress */
            }
            image_free(png);
            image_free(ppm);
            image_free(image);
        }
    }
    /* Every byte of the file counts. */
    static Bytes b;
    Image *image = image_new(9, 2);
    image->rgb[5] = 0.3f;
    image_free(round_trip(image, "d.png", 0));
    load("d.png", &b);
    CHECK(b.n > 8 && changes_taken(&b) == 0 && beginnings_taken(&b, 0) == 0);
    image_free(image);
}

static bool write_refused(const Image *image, const char *path, const char *text)
{
    Report report = { .warnings = stdout };
    bool good = !image_write(image, path, 0, &report) && strncmp(report.error, path, strlen(path)) == 0 && strstr(report.error, text);
    if (!good) printf("expected '%s', got '%s'\n", text, report.error);
    return good;
}

static bool read_refused(const char *path, const char *text)
{
    Report report = { .warnings = stdout };
    Image *image = image_read(path, &report);
    bool good = !image && strncmp(report.error, path, strlen(path)) == 0 && strstr(report.error, text);
    if (!good) printf("expected '%s', got '%s'\n", text, report.error);
    image_free(image);
    return good;
}

static void test_files(void)
{
    static Bytes b;
    static const char *const known[] = { "a.pfm", "a.PPM", "dir.x/a.b.Png", ".png" }, *const unknown[] = { "a", "a.exr", "png", "a.png ", "a.png/b", "" };
    for (unsigned i = 0; i < sizeof known / sizeof *known; i++) CHECK(image_format_known(known[i]));
    for (unsigned i = 0; i < sizeof unknown / sizeof *unknown; i++) CHECK(!image_format_known(unknown[i]));

    Image *image = image_new(100, 100);
    uint32_t state = 3;
    for (unsigned i = 0; i < 30000; i++) image->rgb[i] = (float)random_unit(&state);
    CHECK(write_refused(image, folder_path("a.exr"), "must end in .pfm, .ppm or .png"));
    CHECK(write_refused(image, folder_path("absent/a.png"), strerror(ENOENT)));

    /* A folder of that name: found out only when all is written. */
    CHECK(mkdir(folder_path("folder.png"), 0700) == 0);
    int before = files_in_folder();
    CHECK(write_refused(image, folder_path("folder.png"), "cannot write: "));
    CHECK(files_in_folder() == before);
    CHECK(rmdir(folder_path("folder.png")) == 0);

    /* A disk that fills up, played by a limit on the size of files: the old file stays, nothing else does. */
    static const char *const names[] = { "full.pfm", "full.ppm", "full.png" };
    struct rlimit usual, small;
    CHECK(getrlimit(RLIMIT_FSIZE, &usual) == 0);
    signal(SIGXFSZ, SIG_IGN);
    for (unsigned i = 0; i < 3; i++) {
        folder_write_text(names[i], "old");
        before = files_in_folder();
        for (rlim_t limit = 0; limit <= 20000; limit += 4000) {
            small = usual;
            small.rlim_cur = limit;
            setrlimit(RLIMIT_FSIZE, &small);
            bool good = write_refused(image, folder_path(names[i]), strerror(EFBIG));
            setrlimit(RLIMIT_FSIZE, &usual);
            CHECK(good);
            CHECK(load(names[i], &b) == 3 && memcmp(b.at, "old", 3) == 0);
            CHECK(files_in_folder() == before);
        }
        Report report = { .warnings = stdout };
        CHECK(image_write(image, folder_path(names[i]), 0, &report));                 /* and without the limit replaces it */
        CHECK(load(names[i], &b) > 20000);
        CHECK(files_in_folder() == before);
    }
    Image *tiny = image_new(2, 2);                                                  /* small enough to fail only on closing */
    small = usual;
    small.rlim_cur = 0;
    setrlimit(RLIMIT_FSIZE, &small);
    bool caught = write_refused(tiny, folder_path("tiny.ppm"), strerror(EFBIG));
    setrlimit(RLIMIT_FSIZE, &usual);
    CHECK(caught && files_in_folder() == before);
    image_free(tiny);

    /* A temporary file left behind, or a link laid, does no harm. */
    char temporary[64];
    snprintf(temporary, sizeof temporary, "full.ppm.tmp%ld", (long)getpid());
    folder_write_text("elsewhere", "old");
    CHECK(symlink("elsewhere", folder_path(temporary)) == 0);
    Report report = { .warnings = stdout };
    before = files_in_folder();
    CHECK(image_write(image, folder_path("full.ppm"), 0, &report));
    CHECK(load("elsewhere", &b) == 3 && files_in_folder() == before - 1);
    image_free(image);

    CHECK(read_refused(folder_path("absent.png"), strerror(ENOENT)));
    CHECK(read_refused(folder(), "is a directory"));
    CHECK(read_refused("/dev/null", "not a plain file"));
    CHECK(mkfifo(folder_path("pipe"), 0600) == 0);
    CHECK(read_refused(folder_path("pipe"), "not a plain file"));
    folder_write_text("empty.png", "");
    CHECK(read_refused(folder_path("empty.png"), "the file is empty"));
    folder_write_text("word.png", "word");
    CHECK(read_refused(folder_path("word.png"), "not a PFM, PPM, PGM, PNG or TGA picture"));
    if (geteuid() != 0) {                                                           /* root may read and write all */
        CHECK(chmod(folder_path("word.png"), 0) == 0 && read_refused(folder_path("word.png"), strerror(EACCES)));
        image = image_new(1, 1);
        CHECK(chmod(folder(), 0500) == 0 && write_refused(image, folder_path("a.png"), strerror(EACCES)) && chmod(folder(), 0700) == 0);
        image_free(image);
    }
}

/* ---- The rest ---- */

static void test_new(void)
{
    Image *image = image_new(3, 2);
    int lit = 0;
    CHECK(image && image->width == 3 && image->height == 2);
    for (unsigned i = 0; image && i < 18; i++) lit += image->rgb[i] != 0;
    CHECK(lit == 0);
    image_free(image);
    image_free(NULL);
}

static void test_compare(void)
{
    /* Differences 1 -1 0 2 0 0 of a reference 1 2 3 4 0 2, whose mean is 2: 0.01 m^2 is 0.04. */
    static const float a[6] = { 2, 1, 3, 6, 0, 2 }, b[6] = { 1, 2, 3, 4, 0, 2 };
    Image *x = image_new(1, 2), *y = image_new(1, 2);
    memcpy(x->rgb, a, sizeof a);
    memcpy(y->rgb, b, sizeof b);
    ImageError e = image_compare(x, y);
    CHECK_NEAR(e.rmse, 1, 1e-15);
    CHECK_NEAR(e.relmse, (1 / 1.04 + 1 / 4.04 + 4 / 16.04) / 6, 1e-15);
    CHECK_NEAR(e.ratio_of_means, 14.0 / 12, 1e-15);
    e = image_compare(y, y);
    CHECK(e.rmse == 0 && e.relmse == 0 && e.ratio_of_means == 1);
    x->rgb[3] = NAN;
    e = image_compare(x, y);
    CHECK(isnan(e.rmse) && isnan(e.relmse) && isnan(e.ratio_of_means));
    x->rgb[3] = INFINITY;
    e = image_compare(x, y);
    CHECK(isinf(e.rmse) && isinf(e.relmse) && isinf(e.ratio_of_means));
    image_free(x);
    image_free(y);

    /* A million and more equal floats, whose sum in floats would be far off. */
    x = image_new(700, 700);
    y = image_new(700, 700);
    for (unsigned i = 0; i < 700 * 700 * 3; i++) {
        x->rgb[i] = 0.1f;
        y->rgb[i] = 0.2f;
    }
    e = image_compare(x, y);
    CHECK_NEAR(e.rmse, (double)0.2f - (double)0.1f, 1e-12);
    CHECK_NEAR(e.relmse, 0.25 / 1.01, 1e-7);
    CHECK_NEAR(e.ratio_of_means, 0.5, 1e-7);
    image_free(x);
    image_free(y);
}

/* What both writer and reader rest on, so that they could be wrong together; values known from elsewhere. */
static void test_shared(void)
{
    const unsigned char *digits = (const unsigned char *)"123456789";
    CHECK(png_crc(0, digits, 9) == 0xcbf43926);
    CHECK(png_crc(png_crc(0, digits, 4), digits + 4, 5) == 0xcbf43926);
    CHECK(png_adler((const unsigned char *)"Wikipedia", 9) == 0x11e60398);
    static unsigned char many[100000];
    memset(many, 255, sizeof many);
    uint64_t a = 1, b = 0;
    for (size_t i = 0; i < sizeof many; i++) b += a += 255;
    CHECK(png_adler(many, sizeof many) == (b % 65521 << 16 | a % 65521));
    CHECK(png_paeth(10, 20, 15) == 15 && png_paeth(10, 20, 10) == 20 && png_paeth(10, 20, 20) == 10);
    CHECK(png_paeth(6, 12, 10) == 6 && png_paeth(12, 6, 10) == 6);     /* ties: left before above before the corner */
    CHECK(length_base(0) == 3 && length_base(7) == 10 && length_base(8) == 11 && length_base(27) == 227 && length_base(28) == 258);
    CHECK(length_extra(7) == 0 && length_extra(8) == 1 && length_extra(27) == 5 && length_extra(28) == 0);
    CHECK(distance_base(0) == 1 && distance_base(3) == 4 && distance_base(4) == 5 && distance_base(29) == 24577 && distance_extra(29) == 13);
}

/* Memory for what files hold, not for what they claim; sanitizers need more for themselves. */
static void limit_memory(void)
{
#if defined(__SANITIZE_ADDRESS__)
#define SANITIZED 1
#elif defined(__has_feature)
#define SANITIZED __has_feature(address_sanitizer)
#else
#define SANITIZED 0
#endif
    struct rlimit limit;
    if (SANITIZED || getrlimit(RLIMIT_AS, &limit) != 0) return;
    limit.rlim_cur = 200 << 20;
    CHECK(setrlimit(RLIMIT_AS, &limit) == 0);
}

int main(void)
{
    limit_memory();
    test_shared();
    test_new();
    test_compare();
    test_png_kinds();
    test_png_streams();
    test_png_deflate();
    test_png_chunks();
    test_pnm();
    test_pfm();
    test_tga();
    test_write_pfm();
    test_write_8_bits();
    test_write_png();
    test_files();
    CHECK(folder_remove());
    return check_report();
}
