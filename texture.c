/* Pictures read: PFM, PPM and PGM (P2 P3 P5 P6), PNG, TGA.
 *
 * Sources: PFM as Debevec's tools write it; netpbm's ppm(5) and pgm(5); PNG specification (W3C) with RFC 1950 and 1951; Truevision TGA 2.0.
 * Whole numbers are taken as sRGB whatever gamma a file claims. Alpha is ignored, neither multiplied nor composited. PFM's floats are taken
 * as they are, NaN and infinity too, so that a faulty picture can be compared; of its scale only the sign counts, as with most programs.
 * No format may cost memory that its data cannot fill. Must not know what the picture is for. */
#include "image.h"
#include "png.h"
#include <errno.h>
#include <string.h>
#include <sys/stat.h>

enum { SIDE_MAX = 65535 };
static const uint64_t pixels_max = (uint64_t)1 << 28;

/* What is left to read of a file. */
typedef struct {
    const unsigned char *at, *end;
    const char *name;
    Report *report;
} Source;

static size_t left(const Source *s) { return (size_t)(s->end - s->at); }

static bool fail(const Source *s, const char *what) { return report_error(s->report, s->name, 0, "%s", what); }

static unsigned get_u16(const unsigned char *at) { return (unsigned)at[0] << 8 | at[1]; }
static unsigned get_u16_little(const unsigned char *at) { return (unsigned)at[1] << 8 | at[0]; }
static uint32_t get_u32(const unsigned char *at) { return (uint32_t)get_u16(at) << 16 | get_u16(at + 2); }

static bool size_allowed(const Source *s, uint32_t width, uint32_t height)
{
    if (width == 0 || height == 0) return fail(s, "the picture has no pixels");
    if (width <= SIDE_MAX && height <= SIDE_MAX && (uint64_t)width * height <= pixels_max) return true;
    return report_error(s->report, s->name, 0, "%lu x %lu pixels are too many", (unsigned long)width, (unsigned long)height);
}

static Image *new_image(const Source *s, uint32_t width, uint32_t height)
{
    Image *image = image_new(width, height);
    if (!image) fail(s, "not enough memory");
    return image;
}

/* Linear light of the samples 0..maxval; NULL with an error if memory runs out. */
static float *srgb_curve(const Source *s, unsigned maxval)
{
    float *curve = malloc((maxval + 1) * sizeof *curve);
    if (!curve) {
        fail(s, "not enough memory");
        return NULL;
    }
    for (unsigned i = 0; i <= maxval; i++) {
        double v = (double)i / maxval;
        curve[i] = (float)(v <= 0.04045 ? v / 12.92 : pow((v + 0.055) / 1.055, 2.4));
    }
    return curve;
}

/* ---- PFM, PPM, PGM ---- */

static bool is_space(unsigned char c) { return c == ' ' || (c >= '\t' && c <= '\r'); }
static bool is_digit(unsigned char c) { return c >= '0' && c <= '9'; }

/* White space, and comments from # to the end of the line. */
static void skip_space(Source *s)
{
    for (bool comment = false; s->at < s->end; s->at++) {
        if (*s->at == '#') comment = true;
        else if (*s->at == '\n' || *s->at == '\r') comment = false;
        else if (!comment && !is_space(*s->at)) return;
    }
}

/* The next whole number, a huge one as UINT32_MAX. */
static bool get_number(Source *s, uint32_t *number)
{
    uint64_t value = 0;
    skip_space(s);
    if (s->at == s->end || !is_digit(*s->at)) return false;
    for (; s->at < s->end && is_digit(*s->at); s->at++)
        if (value < UINT32_MAX) value = value * 10 + (*s->at - (unsigned)'0');
    *number = value < UINT32_MAX ? (uint32_t)value : UINT32_MAX;
    return s->at == s->end || is_space(*s->at) || *s->at == '#';
}

/* PFM's scale, as '-1.0' or '1e0', without the C library, whose decimal point depends on the locale. False if it is no number, or zero. */
static bool get_scale_sign(Source *s, bool *negative)
{
    bool mantissa = false, nonzero = false;
    skip_space(s);
    *negative = s->at < s->end && *s->at == '-';
    if (s->at < s->end && (*s->at == '-' || *s->at == '+')) s->at++;
    for (bool point = false; s->at < s->end && (is_digit(*s->at) || (*s->at == '.' && !point)); s->at++) {
        if (*s->at == '.') point = true;
        else mantissa = true;
        if (*s->at >= '1' && *s->at <= '9') nonzero = true;
    }
    if (s->at < s->end && (*s->at == 'e' || *s->at == 'E')) {
        s->at++;
        if (s->at < s->end && (*s->at == '-' || *s->at == '+')) s->at++;
        if (s->at == s->end || !is_digit(*s->at)) return false;
        while (s->at < s->end && is_digit(*s->at)) s->at++;
    }
    return mantissa && nonzero && s->at < s->end && is_space(*s->at);
}

static Image *read_pfm(Source *s)
{
    unsigned channels = s->at[1] == 'F' ? 3 : 1;
    uint32_t width, height;
    bool little;
    s->at += 2;
    if (!get_number(s, &width) || !get_number(s, &height) || !get_scale_sign(s, &little)) {
        fail(s, "broken PFM header");
        return NULL;
    }
    s->at++;
    if (!size_allowed(s, width, height)) return NULL;
    if (left(s) / 4 / channels / width < height) {
        fail(s, "PFM file ends before the picture does");
        return NULL;
    }
    Image *image = new_image(s, width, height);
    for (uint32_t y = height; image && y-- > 0;) {
        float *row = image->rgb + (size_t)y * width * 3;
        for (size_t i = 0; i < (size_t)width * 3; i++) {
            if (channels == 1 && i % 3 > 0) {
                row[i] = row[i - 1];
                continue;
            }
            uint32_t bits = little ? (uint32_t)get_u16_little(s->at + 2) << 16 | get_u16_little(s->at) : get_u32(s->at);
            memcpy(&row[i], &bits, sizeof bits);
            s->at += 4;
        }
    }
    return image;
}

/* One sample; digits where bytes is 0. */
static bool get_sample(Source *s, unsigned bytes, uint32_t maxval, uint32_t *sample)
{
    if (bytes == 0) {
        if (!get_number(s, sample)) return fail(s, left(s) ? "a sample is not a number" : "file ends before the picture does");
    } else {
        *sample = bytes == 1 ? *s->at : get_u16(s->at);
        s->at += bytes;
    }
    return *sample <= maxval || fail(s, "a sample is larger than the header allows");
}

static Image *read_pnm(Source *s)
{
    unsigned channels = s->at[1] == '3' || s->at[1] == '6' ? 3 : 1;
    bool digits = s->at[1] == '2' || s->at[1] == '3';
    uint32_t width, height, maxval;
    s->at += 2;
    if (!get_number(s, &width) || !get_number(s, &height) || !get_number(s, &maxval) || s->at == s->end || !is_space(*s->at)) {
        fail(s, "broken PPM or PGM header");
        return NULL;
    }
    s->at++;
    if (!size_allowed(s, width, height)) return NULL;
    if (maxval < 1 || maxval > 65535) {
        fail(s, "the largest sample must be 1 to 65535");
        return NULL;
    }
    unsigned bytes = digits ? 0 : maxval < 256 ? 1 : 2;
    uint64_t samples = (uint64_t)width * height * channels;
    if (left(s) < (digits ? 2 * samples - 1 : samples * bytes)) {      /* at least a digit each and a space between */
        fail(s, "file ends before the picture does");
        return NULL;
    }
    float *curve = srgb_curve(s, maxval);
    Image *image = curve ? new_image(s, width, height) : NULL;
    for (size_t i = 0; image && i < (size_t)width * height * 3; i++) {
        uint32_t sample;
        if (channels == 1 && i % 3 > 0) {
            image->rgb[i] = image->rgb[i - 1];
        } else if (get_sample(s, bytes, maxval, &sample)) {
            image->rgb[i] = curve[sample];
        } else {
            image_free(image);
            image = NULL;
        }
    }
    free(curve);
    return image;
}

/* ---- Inflate ---- */

typedef struct {
    const unsigned char *at, *end;
    uint64_t bits;             /* the next ones, the first lowest; zeros above */
    unsigned held;
    bool ended;                /* more was asked for than there is; zeros were given */
} BitSource;

static void refill(BitSource *b)
{
    for (; b->held <= 56 && b->at < b->end; b->held += 8) b->bits |= (uint64_t)*b->at++ << b->held;
}

static void drop_bits(BitSource *b, unsigned n)
{
    if (n > b->held) {
        b->ended = true;
        n = b->held;
    }
    b->bits >>= n;
    b->held -= n;
}

/* n <= 16 bits */
static unsigned get_bits(BitSource *b, unsigned n)
{
    refill(b);
    unsigned value = (unsigned)(b->bits & ((1u << n) - 1));
    drop_bits(b, n);
    return value;
}

/* Where the next bits lead: symbol << 4 | length of its code, 0 if no code begins so. As wide as the longest code. */
typedef struct {
    unsigned bits;
    uint16_t entry[1 << CODE_BITS];
} Decoder;

static bool decoder_set(Decoder *d, const unsigned char *lengths, unsigned n)
{
    uint16_t codes[LITERALS + DISTANCES];
    if (!huffman_codes(lengths, n, codes)) return false;
    d->bits = 0;
    for (unsigned i = 0; i < n; i++) if (lengths[i] > d->bits) d->bits = lengths[i];
    memset(d->entry, 0, sizeof *d->entry << d->bits);
    for (unsigned i = 0; i < n; i++)
        for (unsigned at = codes[i]; lengths[i] && at < 1u << d->bits; at += 1u << lengths[i]) d->entry[at] = (uint16_t)(i << 4 | lengths[i]);
    return true;
}

/* The next symbol, or UINT16_MAX if there is no such code. */
static unsigned get_symbol(BitSource *b, const Decoder *d)
{
    refill(b);
    unsigned entry = d->entry[b->bits & ((1u << d->bits) - 1)];
    if (!entry) return UINT16_MAX;
    drop_bits(b, entry & 15);
    return entry >> 4;
}

/* The codes of a block, those of type 1 or those it brings with it. */
static bool get_codes(BitSource *b, unsigned type, Decoder *literals, Decoder *distances)
{
    unsigned char lengths[288 + 32] = { 0 };
    if (type == 1) {
        /* Symbols 286 and 287, distances 30 and 31 have codes that mean nothing. */
        for (unsigned i = 0; i < 288; i++) lengths[i] = i < 144 ? 8 : i < 256 ? 9 : i < 280 ? 7 : 8;
        for (unsigned i = 0; i < 32; i++) lengths[288 + i] = 5;
        return decoder_set(literals, lengths, 288) && decoder_set(distances, lengths + 288, 32);
    }
    static const unsigned char order[19] = { 16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15 };
    unsigned literal_count = 257 + get_bits(b, 5), distance_count = 1 + get_bits(b, 5), order_count = 4 + get_bits(b, 4);
    if (literal_count > LITERALS || distance_count > DISTANCES) return false;
    unsigned char order_lengths[19] = { 0 };
    for (unsigned i = 0; i < order_count; i++) order_lengths[order[i]] = (unsigned char)get_bits(b, 3);
    if (!decoder_set(literals, order_lengths, 19)) return false;
    for (unsigned i = 0; i < literal_count + distance_count;) {
        unsigned symbol = get_symbol(b, literals), repeat = 1;
        unsigned char length = (unsigned char)symbol;
        if (symbol > 18 || (symbol == 16 && i == 0)) return false;
        if (symbol == 16) {
            length = lengths[i - 1];
            repeat = 3 + get_bits(b, 2);
        } else if (symbol > 16) {
            length = 0;
            repeat = symbol == 17 ? 3 + get_bits(b, 3) : 11 + get_bits(b, 7);
        }
        if (repeat > literal_count + distance_count - i) return false;
        while (repeat-- > 0) lengths[i++] = length;
    }
    return decoder_set(literals, lengths, literal_count) && decoder_set(distances, lengths + literal_count, distance_count);
}

static const char too_much[] = "the compressed data holds more than the picture";
static const char cut_short[] = "the compressed data ends too early";
static const char broken_code[] = "broken compressed data";

/* Each block's inflater adds to out[*n], of size bytes, and returns what is wrong, or NULL. */
static const char *inflate_stored(BitSource *b, unsigned char *out, size_t size, size_t *n)
{
    drop_bits(b, b->held % 8);
    unsigned length = get_bits(b, 16);
    if (get_bits(b, 16) != (~length & 0xffff)) return b->ended ? cut_short : broken_code;
    if (length > size - *n) return too_much;
    while (length-- > 0) out[(*n)++] = (unsigned char)get_bits(b, 8);
    return NULL;
}

static const char *inflate_codes(BitSource *b, const Decoder *literals, const Decoder *distances, unsigned char *out, size_t size, size_t *n)
{
    while (!b->ended) {
        unsigned symbol = get_symbol(b, literals);
        if (symbol == END_OF_BLOCK) break;
        if (symbol >= LITERALS) return broken_code;
        if (symbol < END_OF_BLOCK) {
            if (*n == size) return too_much;
            out[(*n)++] = (unsigned char)symbol;
            continue;
        }
        size_t length = length_base(symbol - 257) + get_bits(b, length_extra(symbol - 257));
        unsigned far = get_symbol(b, distances);
        if (far >= DISTANCES) return broken_code;
        size_t distance = distance_base(far) + get_bits(b, distance_extra(far));
        if (distance > *n) return broken_code;
        if (length > size - *n) return too_much;
        for (; length > 0; length--, ++*n) out[*n] = out[*n - distance];
    }
    return NULL;
}

/* Inflates the zlib stream data[n] to exactly out[size]; what is wrong, or NULL. */
static const char *zlib_expand(const unsigned char *data, size_t n, unsigned char *out, size_t size)
{
    if (n < 2) return cut_short;
    if ((data[0] & 15) != 8 || data[0] >> 4 > 7 || data[1] & 32 || get_u16(data) % 31) return "not a zlib stream that PNG allows";
    BitSource b = { .at = data + 2, .end = data + n };
    Decoder *decoders = malloc(2 * sizeof *decoders);
    if (!decoders) return "not enough memory";
    const char *wrong = NULL;
    size_t done = 0;
    for (bool last = false; !wrong && !last;) {
        last = get_bits(&b, 1);
        unsigned type = get_bits(&b, 2);
        if (type == 3) wrong = broken_code;
        else if (type == 0) wrong = inflate_stored(&b, out, size, &done);
        else if (!get_codes(&b, type, &decoders[0], &decoders[1])) wrong = broken_code;
        else wrong = inflate_codes(&b, &decoders[0], &decoders[1], out, size, &done);
        if (b.ended) wrong = cut_short;
    }
    free(decoders);
    if (wrong) return wrong;
    if (done < size) return "the compressed data holds less than the picture";
    drop_bits(&b, b.held % 8);
    uint32_t adler = 0;
    for (int i = 0; i < 4; i++) adler = adler << 8 | get_bits(&b, 8);
    return b.ended ? cut_short : adler != png_adler(out, size) ? "the compressed data's checksum is wrong" : NULL;
}

/* ---- PNG ---- */

typedef struct {
    uint32_t width, height;
    unsigned depth, type, channels, pixel_bits;        /* type: 1 palette, 2 colour, 4 alpha, added up */
    bool interlaced;
    unsigned char palette[256 * 3];
    unsigned palette_size;
    unsigned char *packed;                             /* all IDAT, owned by read_png */
    size_t packed_size;
} Png;

static bool png_header(Source *s, const unsigned char *data, size_t n, Png *png)
{
    static const unsigned char channels[7] = { 1, 0, 3, 1, 2, 0, 4 };
    static const unsigned depths[7] = { 1 | 2 | 4 | 8 | 16, 0, 8 | 16, 1 | 2 | 4 | 8, 8 | 16, 0, 8 | 16 };      /* allowed: powers of two, or-ed */
    if (n != 13) return fail(s, "broken PNG header");
    png->width = get_u32(data);
    png->height = get_u32(data + 4);
    png->depth = data[8];
    png->type = data[9];
    png->interlaced = data[12] == 1;
    if (!size_allowed(s, png->width, png->height)) return false;
    bool power = png->depth > 0 && (png->depth & (png->depth - 1)) == 0;
    if (!power || png->type > 6 || !(depths[png->type] & png->depth)) return fail(s, "no such PNG colour type and bit depth");
    if (data[10] || data[11] || data[12] > 1) return fail(s, "unknown PNG compression, filter or interlace method");
    png->channels = channels[png->type];
    png->pixel_bits = png->channels * png->depth;
    return true;
}

/* Takes in all chunks to IEND. */
static bool png_chunks(Source *s, Png *png)
{
    for (bool first = true;; first = false) {
        if (left(s) < 12) return fail(s, "PNG file ends too early");
        uint32_t n = get_u32(s->at);
        const unsigned char *type = s->at + 4, *data = s->at + 8;
        if (n > left(s) - 12) return fail(s, "PNG file ends too early");
        if (png_crc(0, type, (size_t)n + 4) != get_u32(data + n)) return fail(s, "a PNG chunk's checksum is wrong");
        s->at += (size_t)n + 12;
        bool header = memcmp(type, "IHDR", 4) == 0;
        if (header != first) return fail(s, "a PNG file must begin with its header, and have one");
        if (header) {
            if (!png_header(s, data, n, png)) return false;
        } else if (memcmp(type, "PLTE", 4) == 0) {
            if (n == 0 || n % 3 || n > sizeof png->palette) return fail(s, "broken PNG palette");
            memcpy(png->palette, data, n);
            png->palette_size = n / 3;
        } else if (memcmp(type, "IDAT", 4) == 0) {
            memcpy(png->packed + png->packed_size, data, n);
            png->packed_size += n;
        } else if (memcmp(type, "IEND", 4) == 0) {
            return true;
        } else if (!(type[0] & 32)) {                  /* a capital: not to be passed over */
            return fail(s, "unknown PNG chunk that cannot be ignored");
        }
    }
}

/* The pixels of one pass: column x0 + i dx, row y0 + j dy. */
typedef struct { unsigned x0, y0, dx, dy; } Pass;

static uint32_t steps(uint32_t size, unsigned begin, unsigned step) { return size > begin ? (size - begin + step - 1) / step : 0; }
static size_t row_bytes(const Png *png, Pass pass) { return ((size_t)steps(png->width, pass.x0, pass.dx) * png->pixel_bits + 7) / 8; }

/* Undoes a row's filter in place; above is NULL for the first row of a pass. bpp: distance in bytes to the pixel on the left. */
static bool unfilter(unsigned type, unsigned char *row, const unsigned char *above, size_t n, size_t bpp)
{
    if (type > 4) return false;
    for (size_t i = 0; i < n; i++) {
        unsigned a = i >= bpp ? row[i - bpp] : 0, b = above ? above[i] : 0, c = above && i >= bpp ? above[i - bpp] : 0;
        unsigned guess = type == 1 ? a : type == 2 ? b : type == 3 ? (a + b) / 2 : type == 4 ? png_paeth((int)a, (int)b, (int)c) : 0;
        row[i] = (unsigned char)(row[i] + guess);
    }
    return true;
}

static unsigned png_sample(const unsigned char *row, size_t i, unsigned depth)
{
    if (depth == 8) return row[i];
    if (depth == 16) return get_u16(row + 2 * i);
    return (unsigned)row[i * depth / 8] >> (8 - depth - i * depth % 8) & ((1u << depth) - 1);
}

static bool png_row(const Source *s, const Png *png, const unsigned char *row, const float *curve, Pass pass, float *rgb)
{
    for (size_t i = 0, x = pass.x0; x < png->width; i++, x += pass.dx) {
        for (unsigned k = 0; k < 3; k++) {
            unsigned sample = png_sample(row, i * png->channels + (png->channels >= 3 ? k : 0), png->depth);
            if (png->type == 3) {
                if (sample >= png->palette_size) return fail(s, "a pixel's colour is not in the palette");
                sample = png->palette[3 * sample + k];
            }
            rgb[3 * x + k] = curve[sample];
        }
    }
    return true;
}

static Image *png_pixels(const Source *s, const Png *png)
{
    static const Pass passes[8] = {
        { 0, 0, 1, 1 }, { 0, 0, 8, 8 }, { 4, 0, 8, 8 }, { 0, 4, 4, 8 }, { 2, 0, 4, 4 }, { 0, 2, 2, 4 }, { 1, 0, 2, 2 }, { 0, 1, 1, 2 }
    };
    unsigned first = png->interlaced ? 1 : 0, last = png->interlaced ? 7 : 0;
    size_t size = 0;
    for (unsigned p = first; p <= last; p++) {
        size_t n = row_bytes(png, passes[p]);
        if (n) size += (n + 1) * steps(png->height, passes[p].y0, passes[p].dy);
    }
    if (size / 1032 > png->packed_size) {              /* deflate's best: 258 bytes from two bits */
        fail(s, cut_short);
        return NULL;
    }
    unsigned char *lines = malloc(size);
    float *curve = srgb_curve(s, png->type == 3 ? 255 : (1u << png->depth) - 1);
    const char *wrong = lines && curve ? zlib_expand(png->packed, png->packed_size, lines, size) : "not enough memory";
    bool good = !wrong || fail(s, wrong);
    Image *image = good ? new_image(s, png->width, png->height) : NULL;
    unsigned char *line = lines;
    good = image;
    for (unsigned p = first; good && p <= last; p++) {
        size_t n = row_bytes(png, passes[p]);
        const unsigned char *above = NULL;
        for (size_t y = passes[p].y0; good && n && y < png->height; y += passes[p].dy) {
            good = unfilter(line[0], line + 1, above, n, (png->pixel_bits + 7) / 8) || fail(s, "unknown PNG filter");
            good = good && png_row(s, png, line + 1, curve, passes[p], image->rgb + y * png->width * 3);
            above = line + 1;
            line += n + 1;
        }
    }
    free(lines);
    free(curve);
    if (good) return image;
    image_free(image);
    return NULL;
}

static Image *read_png(Source *s)
{
    Png png = { .packed = malloc(left(s)) };
    s->at += 8;
    Image *image = NULL;
    if (!png.packed) fail(s, "not enough memory");
    else if (png_chunks(s, &png)) image = png_pixels(s, &png);
    free(png.packed);
    return image;
}

/* ---- TGA ---- */

typedef struct {
    unsigned kind, depth, map_first, map_size, map_depth;          /* kind: 1 mapped, 2 true colour, 3 grey */
    bool rle, from_right, from_top;
    uint32_t width, height;
    const unsigned char *map;
    const float *curve8, *curve5;
} Tga;

/* Colour of 15, 16, 24 or 32 bits: blue, green, red from the lowest bit up. */
static void tga_colour(const Tga *t, const unsigned char *at, unsigned depth, float rgb[3])
{
    for (unsigned k = 0; k < 3; k++)
        rgb[k] = depth > 16 ? t->curve8[at[2 - k]] : t->curve5[get_u16_little(at) >> (10 - 5 * k) & 31];
}

static bool tga_pixel(const Source *s, const Tga *t, const unsigned char *at, float rgb[3])
{
    if (t->kind == 2) {
        tga_colour(t, at, t->depth, rgb);
    } else if (t->kind == 3) {
        rgb[0] = rgb[1] = rgb[2] = t->curve8[*at];                 /* a second byte is alpha */
    } else {
        unsigned index = t->depth == 8 ? *at : get_u16_little(at);
        if (index - t->map_first >= t->map_size) return fail(s, "a pixel's colour is not in the palette");         /* nor below it: unsigned */
        tga_colour(t, t->map + (size_t)(index - t->map_first) * ((t->map_depth + 7) / 8), t->map_depth, rgb);
    }
    return true;
}

/* False if it cannot be TGA, which has no mark of its own. Moves s to the palette. */
static bool tga_header(Source *s, Tga *t)
{
    const unsigned char *h = s->at;
    if (left(s) < 18) return false;
    *t = (Tga){
        .kind = h[2] & 7, .rle = h[2] & 8, .map_first = get_u16_little(h + 3), .map_size = get_u16_little(h + 5), .map_depth = h[7],
        .width = get_u16_little(h + 12), .height = get_u16_little(h + 14), .depth = h[16], .from_right = h[17] & 16, .from_top = h[17] & 32
    };
    bool colour = t->depth == 15 || t->depth == 16 || t->depth == 24 || t->depth == 32;
    bool map_colour = t->map_depth == 15 || t->map_depth == 16 || t->map_depth == 24 || t->map_depth == 32;
    bool mapped = t->depth == 8 || t->depth == 16;
    if (h[1] > 1 || (h[1] == 1 && !map_colour) || h[2] > 11 || h[17] > 63) return false;       /* above 63: interleaved rows, never used */
    if (h[1] == 0) t->map_size = 0;
    if (left(s) - 18 < h[0]) return false;
    s->at += 18 + h[0];
    return t->kind == 1 ? h[1] == 1 && mapped : t->kind == 2 ? colour : t->kind == 3 && mapped;
}

/* Pixels in the order of the file, by packets: the lower seven bits of the first byte + 1 pixels, the high bit set if all are the one that
 * follows. Packets may go on into the next row. */
static bool tga_pixels(Source *s, const Tga *t, Image *image)
{
    const unsigned char *pixel = NULL;
    size_t bytes = (t->depth + 7) / 8;
    unsigned run = 0;
    bool repeat = false;
    for (uint32_t j = 0; j < t->height; j++) {
        float *row = image->rgb + (size_t)(t->from_top ? j : t->height - 1 - j) * t->width * 3;
        for (uint32_t i = 0; i < t->width; i++) {
            bool packet = t->rle && run == 0;
            if (packet) {
                if (s->at == s->end) return fail(s, "TGA file ends before the picture does");
                run = (*s->at & 127u) + 1;
                repeat = *s->at++ & 128;
            }
            if (packet || !repeat) {
                if (left(s) < bytes) return fail(s, "TGA file ends before the picture does");
                pixel = s->at;
                s->at += bytes;
            }
            run -= t->rle;
            if (!tga_pixel(s, t, pixel, row + 3 * (t->from_right ? t->width - 1 - i : i))) return false;
        }
    }
    return true;
}

static Image *read_tga(Source *s)
{
    Tga t;
    if (!tga_header(s, &t)) {
        fail(s, "not a PFM, PPM, PGM, PNG or TGA picture");
        return NULL;
    }
    if (!size_allowed(s, t.width, t.height)) return NULL;
    size_t map_bytes = (size_t)t.map_size * ((t.map_depth + 7) / 8), bytes = (t.depth + 7) / 8, pixels = (size_t)t.width * t.height;
    size_t least = t.rle ? (pixels + 127) / 128 * (1 + bytes) : pixels * bytes;        /* what the shortest file would hold */
    if (left(s) < map_bytes || left(s) - map_bytes < least) {
        fail(s, "TGA file ends before the picture does");
        return NULL;
    }
    t.map = s->at;
    s->at += map_bytes;
    float *curve8 = srgb_curve(s, 255), *curve5 = srgb_curve(s, 31);
    t.curve8 = curve8;
    t.curve5 = curve5;
    Image *image = curve8 && curve5 ? new_image(s, t.width, t.height) : NULL;
    if (image && !tga_pixels(s, &t, image)) {
        image_free(image);
        image = NULL;
    }
    free(curve8);
    free(curve5);
    return image;
}

/* ---- */

Image *image_decode(const unsigned char *data, size_t n, const char *name, Report *report)
{
    Source s = { data, data + n, name, report };
    if (n == 0) {
        fail(&s, "the file is empty");
        return NULL;
    }
    if (n >= 8 && memcmp(data, "\x89PNG\r\n\x1a\n", 8) == 0) return read_png(&s);
    bool letter = n >= 3 && data[0] == 'P' && (is_space(data[2]) || data[2] == '#');
    if (letter && (data[1] == 'F' || data[1] == 'f')) return read_pfm(&s);
    if (letter && memchr("2356", data[1], 4)) return read_pnm(&s);
    return read_tga(&s);
}

Image *image_read(const char *path, Report *report)
{
    struct stat status;
    if (stat(path, &status) != 0) {
        report_error(report, path, 0, "cannot read: %s", strerror(errno));
        return NULL;
    }
    if (!S_ISREG(status.st_mode)) {                    /* a pipe may never open or end */
        report_error(report, path, 0, S_ISDIR(status.st_mode) ? "is a directory" : "not a plain file");
        return NULL;
    }
    size_t size = (size_t)status.st_size;
    unsigned char *data = malloc(size + 1);
    FILE *file = data ? fopen(path, "rb") : NULL;
    size_t n = file ? fread(data, 1, size, file) : 0;
    bool good = file && !ferror(file);
    Image *image = NULL;
    if (good) image = image_decode(data, n, path, report);
    else report_error(report, path, 0, "cannot read: %s", strerror(errno));
    if (file) fclose(file);
    free(data);
    return image;
}
