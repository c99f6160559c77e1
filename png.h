/* What the PNG writer (image.c) and reader (texture.c) have in common: checksums, the Paeth predictor, the numbering of deflate's codes.
 *
 * Sources: PNG specification (W3C, third edition), RFC 1950 (zlib), RFC 1951 (deflate). Private to those two files. */
#ifndef PNG_H
#define PNG_H
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

enum {
    CODE_BITS = 15,            /* longest Huffman code */
    LITERALS = 286,            /* bytes, end of block, 29 match lengths */
    DISTANCES = 30,
    END_OF_BLOCK = 256,
    MATCH_MIN = 3, MATCH_MAX = 258,
    WINDOW = 32768
};

/* CRC-32 (polynomial 0x04c11db7, reflected) of n more bytes; crc is 0 to begin with, or what the bytes before gave.
 * Half a byte at a time: a table of 16 can be written down, one of 256 would have to be computed and kept. */
static inline uint32_t png_crc(uint32_t crc, const unsigned char *data, size_t n)
{
    static const uint32_t table[16] = {
        0x00000000, 0x1db71064, 0x3b6e20c8, 0x26d930ac, 0x76dc4190, 0x6b6b51f4, 0x4db26158, 0x5005713c,
        0xedb88320, 0xf00f9344, 0xd6d6a3e8, 0xcb61b38c, 0x9b64c2b0, 0x86d3d2d4, 0xa00ae278, 0xbdbdf21c
    };
    crc = ~crc;
    for (size_t i = 0; i < n; i++) {
        crc ^= data[i];
        crc = table[crc & 15] ^ crc >> 4;
        crc = table[crc & 15] ^ crc >> 4;
    }
    return ~crc;
}

static inline uint32_t png_adler(const unsigned char *data, size_t n)
{
    uint32_t a = 1, b = 0;
    while (n > 0) {
        size_t run = n < 5552 ? n : 5552;       /* b stays below 2^32 this long */
        for (size_t i = 0; i < run; i++) b += a += data[i];
        a %= 65521;
        b %= 65521;
        data += run;
        n -= run;
    }
    return b << 16 | a;
}

/* Of left, above and above left, the one nearest to left + above - above_left. */
static inline unsigned png_paeth(int left, int above, int above_left)
{
    int to_left = abs(above - above_left), to_above = abs(left - above_left), to_both = abs(left + above - 2 * above_left);
    return (unsigned)(to_left <= to_above && to_left <= to_both ? left : to_above <= to_both ? above : above_left);
}

/* Match length code 0..28 (symbol 257..285) stands for its base and the next 2^extra - 1 lengths; distance code 0..29 likewise.
 * Lengths come four, distances two codes to the power of two. */
static inline unsigned length_extra(unsigned code) { return code < 8 || code == 28 ? 0 : code / 4 - 1; }
static inline unsigned length_base(unsigned code)
{
    return code < 8 ? MATCH_MIN + code : code == 28 ? MATCH_MAX : MATCH_MIN + ((4 + code % 4) << length_extra(code));
}
static inline unsigned distance_extra(unsigned code) { return code < 4 ? 0 : code / 2 - 1; }
static inline unsigned distance_base(unsigned code) { return code < 2 ? 1 + code : 1 + ((2 + code % 2) << distance_extra(code)); }

/* The codes of n symbols from their lengths in bits (0: not used), bit-reversed as the stream holds them, first bit lowest.
 * False if there are more codes than such lengths leave room for. */
static inline bool huffman_codes(const unsigned char *lengths, unsigned n, uint16_t *codes)
{
    unsigned count[CODE_BITS + 1] = { 0 }, next[CODE_BITS + 2] = { 0 };
    for (unsigned i = 0; i < n; i++) count[lengths[i]]++;
    count[0] = 0;
    for (unsigned bits = 1; bits <= CODE_BITS; bits++) {
        if (next[bits] + count[bits] > 1u << bits) return false;
        next[bits + 1] = (next[bits] + count[bits]) << 1;
    }
    for (unsigned i = 0; i < n; i++) {
        unsigned code = lengths[i] ? next[lengths[i]]++ : 0, reversed = 0;
        for (unsigned bit = 0; bit < lengths[i]; bit++) reversed |= (code >> bit & 1) << (lengths[i] - 1 - bit);
        codes[i] = (uint16_t)reversed;
    }
    return true;
}
#endif
