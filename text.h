/* Text files as obj.c and mtl.c read them: blocks of whole lines, numbers, names, files that a line names, and warnings that are counted
 * instead of repeated. Knows nothing of geometry or materials.
 *
 * A Text hands out blocks in which every line is whole and ended by \n, \r or \r\n, also the last line of a file that ends without one.
 * Loops over characters therefore need no bound: the end of the line stops them. */
#ifndef TEXT_H
#define TEXT_H
#include "obj.h"
#include <float.h>
#include <stddef.h>
#if defined(__AVX2__) && defined(__BMI__)
#include <immintrin.h>
#endif

enum { TEXT_MARGIN = 8, TEXT_PADDING = 80 };           /* bytes that may be read before a block and past its end */

typedef struct {
    const char *path;
    char *p, *end;                     /* the block; the caller may write into it */
    unsigned long line;                /* number of the first line not yet passed, from 1; the caller counts with text_next_line */
    unsigned long joined;              /* line ends that text_join has taken out of this line */
    const char *error;                 /* when text_more has said false: what is wrong, or NULL at the end of the file */
    char *buffer;
    size_t size, filled;
    uint64_t left;                     /* bytes of the file, as far as is known, that are not yet in the buffer */
    int fd;
    bool started, at_end;
} Text;

/* False if the file cannot be read; t->error says why, error_number is errno. After a true, close with text_close. */
bool text_open(Text *t, const char *path, int *error_number);
bool text_more(Text *t);
void text_close(Text *t);

/* Lines ended by a backslash, blanks allowed after it: writes blanks over the backslash and the line end, so that the line at 'start' goes on,
 * up to the first line without one or with a comment. False if there was none. */
bool text_join(Text *t, char *start);

static inline bool is_blank(char c) { return c == ' ' || c == '\t' || c == '\v' || c == '\f'; }
static inline bool is_line_end(char c) { return c == '\n' || c == '\r'; }
/* Whether nothing more stands on the line: what follows # is a comment. */
static inline bool is_stop(char c) { return is_line_end(c) || c == '#'; }
static inline bool is_token_end(char c) { return is_blank(c) || is_stop(c) || c == '\\'; }

static inline char *skip_blanks(char *p)
{
    while (is_blank(*p)) p++;
    return p;
}
static inline char *skip_token(char *p)
{
    while (!is_token_end(*p)) p++;
    return p;
}
static inline char *find_line_end(char *p)
{
    while (!is_line_end(*p)) p++;
    return p;
}

/* The rest of the line as a name, blanks inside and # included: its length. */
static inline size_t rest_of_line(char *p)
{
    char *end = find_line_end(p);
    while (end > p && is_blank(end[-1])) end--;
    return (size_t)(end - p);
}

/* The length of a name without ' # comment', if there is one. */
static inline size_t before_comment(const char *name, size_t n)
{
    for (size_t i = 1; i < n; i++)
        if (name[i] == '#' && is_blank(name[i - 1])) {
            while (i > 0 && is_blank(name[i - 1])) i--;
            return i;
        }
    return n;
}

/* Counts the line that ends at p and returns where the next one begins. */
static inline char *text_next_line(Text *t, char *p)
{
    t->line += 1 + t->joined;
    t->joined = 0;
    return p + (p[0] == '\r' && p[1] == '\n') + 1;
}

/* The same for a line of which only blanks or a comment may be left at p; NULL, and nothing counted, if there is more. */
static inline char *text_finish_line(Text *t, char *p)
{
    if (*p != '\n') {
        p = skip_blanks(p);
        if (*p == '#') p = find_line_end(p);
        if (!is_line_end(*p)) return NULL;
    }
    return text_next_line(t, p);
}

/* Numbers. */

/* The number of the lowest byte whose top bit is set in v, which has no other bits; 8 if there is none. */
static inline unsigned lowest_mark(uint64_t v)
{
#if defined(__GNUC__)
    return v ? (unsigned)__builtin_ctzll(v) / 8 : 8;
#else
    return (unsigned)((((v - 1) & ~v) >> 7 & 0x0101010101010101u) * 0x0101010101010101u >> 56);
#endif
}

/* Reads the digits at p, at most eight; returns how many. Works on eight bytes at once: no branch depends on their number. */
static inline unsigned scan_digits(const char *p, uint64_t *value)
{
    const unsigned char *b = (const unsigned char *)p;
    uint64_t v = (uint64_t)b[0] | (uint64_t)b[1] << 8 | (uint64_t)b[2] << 16 | (uint64_t)b[3] << 24
               | (uint64_t)b[4] << 32 | (uint64_t)b[5] << 40 | (uint64_t)b[6] << 48 | (uint64_t)b[7] << 56;
    v ^= 0x3030303030303030u;                                                  /* a digit becomes 0..9 */
    uint64_t other = ((v + 0x7676767676767676u) | v) & 0x8080808080808080u;    /* the lowest bit set is right; a carry may spoil those above */
    unsigned n = lowest_mark(other);
    v = v << 4 * (8 - n) << 4 * (8 - n);                                       /* zeros before the first digit; two steps for n = 0 */
    v = v * 10 + (v >> 8);                                                     /* pairs, in bytes 0, 2, 4, 6 */
    v = ((v & 0x000000ff000000ffu) * 0x000f424000000064u + (v >> 16 & 0x000000ff000000ffu) * 0x0000271000000001u) >> 32;
    *value = v & 0xffffffffu;
    return n;
}

static const double POWER_OF_TEN[] = {
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22
};
static const uint32_t POWER_OF_TEN_32[] = { 1, 10, 100, 1000, 10000, 100000, 1000000, 10000000, 100000000 };

/* digits * 10^exponent, correctly rounded; infinite if too large. */
double number_round(uint64_t digits, int exponent);
/* Any number, the long way. Returns where it ends, NULL if there is none at p or it is not finite. */
const char *number_scan_any(const char *p, double *value);

/* Reads the number at p; returns where it ends, NULL if there is none or it is not finite. Whether what follows may follow is for the caller
 * to say. Eight bytes past the first that is no part of a number must be readable. */
static inline char *number_scan(char *p, double *value)
{
    char *start = p;
    bool negative = *p == '-';
    if (*p < '.') p += negative | (*p == '+');
    uint64_t digits = (uint64_t)(*p - '0'), more;
    unsigned n = 1, decimals = 0;
    if (p[1] == '.' && digits <= 9) p++;       /* most numbers in mesh files; what is predicted need not be waited for */
    else p += n = scan_digits(p, &digits);
    if (*p == '.') {
        decimals = scan_digits(++p, &more);
        digits = digits * POWER_OF_TEN_32[decimals] + more;
        p += decimals;
        if (decimals == 8) {
            unsigned k = scan_digits(p, &more);
            digits = digits * POWER_OF_TEN_32[k] + more;
            p += k;
            decimals += k;
        }
        n += decimals;
    } else if (n == 8) return (char *)number_scan_any(start, value);
    if (n == 0 || n > 19 || decimals == 16 || (*p | 32) == 'e') return (char *)number_scan_any(start, value);
    /* Both are exact in a double, so that one division rounds once. */
    double v = FLT_EVAL_METHOD == 0 && digits >> 53 == 0 ? (double)(int64_t)digits / POWER_OF_TEN[decimals] : number_round(digits, -(int)decimals);
    *value = negative ? -v : v;
    return p;
}

#if defined(__AVX2__) && defined(__BMI__)
/* Lines of numbers as most files have them, the ends of all tokens found at once. Much the same as above; in fewer instructions, which is what
 * bounds the time of reading. */

static inline uint64_t lowest_bit(uint64_t v) { return _tzcnt_u64(v); }       /* its number, 64 if there is none */

/* Which of the 32 bytes at p are no digits: bit i for p[i]. */
static inline uint32_t non_digits(const char *p)
{
    __m256i v = _mm256_sub_epi8(_mm256_loadu_si256((const void *)p), _mm256_set1_epi8('0' - 128));     /* a digit becomes -128..-119 */
    return (uint32_t)_mm256_movemask_epi8(_mm256_cmpgt_epi8(v, _mm256_set1_epi8(-119)));
}

static inline __m128i load_pair(const void *low, const void *high)
{
    return _mm_castps_si128(_mm_loadh_pi(_mm_castsi128_ps(_mm_loadl_epi64(low)), high));
}

/* The values of the n_a digits before a and, times 2^32, of the n_b digits before b. 0 to 8 digits; eight bytes before a and b must be readable. */
static inline uint64_t digits_pair(const char *a, uint64_t n_a, const char *b, uint64_t n_b)
{
    static const uint64_t last[] = { 0, 0x0f00000000000000, 0x0f0f000000000000, 0x0f0f0f0000000000, 0x0f0f0f0f00000000, 0x0f0f0f0f0f000000,
        0x0f0f0f0f0f0f0000, 0x0f0f0f0f0f0f0f00, 0x0f0f0f0f0f0f0f0f };
    __m128i v = _mm_and_si128(load_pair(a - 8, b - 8), load_pair(&last[n_a], &last[n_b]));
    v = _mm_maddubs_epi16(v, _mm_set1_epi16(0x010a));                          /* by tens, */
    v = _mm_madd_epi16(v, _mm_set1_epi32(0x00010064));                         /* hundreds, */
    v = _mm_madd_epi16(_mm_packus_epi32(v, v), _mm_set1_epi32(0x00012710));    /* ten thousands */
    return (uint64_t)_mm_cvtsi128_si64(v);
}

/* Reads n numbers, [-]digits[.digits] of at most 7 digits before the point and 15 in all, one blank between them. Returns where the last ends, NULL if
 * they are not that. TEXT_MARGIN bytes before and TEXT_PADDING after p must be readable. */
static inline char *numbers_scan(char *p, int n, double *value)
{
    static const double sign[] = { 1, -1 };
    uint64_t marks = non_digits(p) | (uint64_t)non_digits(p + 32) << 32, start = 0;
    for (int i = 0;; i++) {
        uint64_t negative = p[start] == '-', decimals = 0;
        marks &= marks - negative;
        uint64_t point = lowest_bit(marks), whole = point - start - negative, end = point;
        if (p[point] == '.') {
            marks &= marks - 1;
            end = lowest_bit(marks);
            decimals = end - point - 1;
        }
        marks &= marks - 1;
        start = end + 1;
        if (whole - 1 >= 7 || decimals > 15 - whole || (p[end] != ' ' && (i < n - 1 || !is_token_end(p[end])))) return NULL;
        uint64_t rest = decimals > 8 ? decimals - 8 : 0, pair = digits_pair(p + point, whole, p + end - rest, decimals - rest);
        uint64_t digits = (pair & 0xffffffffu) * POWER_OF_TEN_32[decimals - rest] + (pair >> 32);
        if (rest) digits = digits * POWER_OF_TEN_32[rest] + (digits_pair(p + end, rest, p + end, rest) >> 32);
        /* Both are exact in a double, so that one division rounds once. */
        value[i] = (double)(int64_t)digits / POWER_OF_TEN[decimals] * sign[negative];
        if (i == n - 1) return p + end;
    }
}

/* Reads V, V/VT, V//VN or V/VT/VN with a blank or line end after it, no index 0 or of more than 8 digits; what is absent is 0. Returns where it ends,
 * NULL if it is not that. What must be readable is as above. */
static inline char *indices_scan(char *p, uint32_t index[3])
{
    uint64_t marks = non_digits(p), a = lowest_bit(marks), b = a, end = a, n_b = 0, n_end = 0;
    if (p[a] == '/') {
        b = end = lowest_bit(marks &= marks - 1);
        n_b = b - a - 1;
        if (p[b] == '/') {
            end = lowest_bit(marks & (marks - 1));
            n_end = end - b - 1;
        }
    }
    if (a - 1 > 7 || n_b > 8 || n_end > 8 || (p[end] != ' ' && !is_line_end(p[end]))) return NULL;
    uint64_t pair = digits_pair(p + a, a, p + b, n_b);
    index[0] = (uint32_t)pair;
    index[1] = (uint32_t)(pair >> 32);
    index[2] = (uint32_t)digits_pair(p + end, n_end, p + end, n_end);
    return index[0] && (index[1] || !n_b) && (index[2] || !n_end) ? p + end : NULL;
}
#else
static inline char *numbers_scan(char *p, int n, double *value) { return (void)p, (void)n, (void)value, NULL; }
static inline char *indices_scan(char *p, uint32_t index[3]) { return (void)p, (void)index, NULL; }
#endif

/* Reads the integer at p, saturated at +-2^40; returns where it ends, NULL if there is none. */
static inline char *integer_scan(char *p, int64_t *value)
{
    bool negative = *p == '-';
    p += negative | (*p == '+');
    uint64_t v;
    unsigned n = scan_digits(p, &v);
    if (n == 0) return NULL;
    p += n;
    if (n == 8)
        for (; *p >= '0' && *p <= '9'; p++)
            if (v < (uint64_t)1 << 40) v = v * 10 + (uint64_t)(*p - '0');
    int64_t signed_v = v < (uint64_t)1 << 40 ? (int64_t)v : (int64_t)1 << 40;
    *value = negative ? -signed_v : signed_v;
    return p;
}

/* A token of a file as a message shows it: cut short, without control characters. */
typedef struct { char text[48]; } Quoted;
Quoted quote(const char *s, size_t n);
Quoted quote_token(char *p);

/* What is wrong with the token at p, of which number_scan could make nothing. */
const char *number_fault(char *p);

/* Warnings: each kind once, where it was first met, with how often. */

typedef struct {
    const char *path, *kind;           /* must outlive the Notes */
    Quoted name;
    unsigned long line, count;
} Note;

typedef struct {
    Note note[40];
    int n;
    unsigned long dropped;             /* of kinds beyond these */
} Notes;

/* The warning 'kind' or, with a name, 'kind 'name''. */
void note(Notes *notes, const char *path, unsigned long line, const char *kind);
void note_name(Notes *notes, const char *path, unsigned long line, const char *kind, const char *name, size_t n);
void notes_print(const Notes *notes, Report *report);

/* A set of strings, numbered from 0 in the order of their first appearance. */
typedef struct {
    char **name;
    uint32_t n, capacity, *slot, slots;
} Names;

/* BVH_NONE if it is not there. */
uint32_t names_find(const Names *names, const char *s, size_t n);
/* The number of the string, new or not; BVH_NONE if memory runs out. */
uint32_t names_add(Names *names, const char *s, size_t n);
void names_free(Names *names);

/* Makes room for one more than n items, and for as many more as are likely to come: memory that is not touched costs nothing, memory that moves does.
 * False if memory or numbers run out: items are numbered up to 2^32-2. */
bool array_grow(void *array, uint32_t n, uint32_t *capacity, size_t item_size, uint64_t likely);

/* The path of the regular file that s[0..n-1], read in the file 'from', names: relative to the folder of 'from', as it stands or, in this order,
 * without quotes, with / for \, without ' # comment'. NULL if there is none such; free it. */
char *text_find_file(const char *from, const char *s, size_t n);
#endif
