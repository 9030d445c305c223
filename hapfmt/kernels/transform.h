/* The loops of SPEC 9.8. The readable twin is hapfmt/codecs/transform.py.

   The input is hostile: a magnitude is checked against 2^34, and the sum of a block against 2^36, before
   they are used. So sums of the transform stay below 2^52, where doubles are exact in any order. */
#ifndef HAPFMT_TRANSFORM_H
#define HAPFMT_TRANSFORM_H

#include <stddef.h>

#include "coded.h"

#ifdef WIDE
#include <immintrin.h>
#endif

enum { SIZE_MOST = 512, STATES = 8, BAD_SUM = 8, COSINE_BITS = 15, TILE = 16, BATCH = 8, PLAIN_SYMBOLS = 10,
       SMALL_LEVELS = 32767 };
static const double SUM_LIMIT = 68719476736.0;

static const uint8_t next_state[STATES][2] = {{0, 2}, {5, 7}, {1, 3}, {4, 6}, {2, 0}, {7, 5}, {3, 1}, {6, 4}};

/* What the blocks before say of each coefficient. ``before`` and ``mean`` are 256 times magnitudes, the
   first and the last one of ``before`` twice. */
typedef struct {
    int count, size;
    int64_t before[SIZE_MOST + 2], mean[SIZE_MOST], around[SIZE_MOST];
} neighbours;

static void neighbours_from(neighbours *n, int size, int count, int start)
{
    int64_t mean = averages_from(start).f;
    n->size = size;
    n->count = count;
    for (int k = 0; k < count + 2; k++) n->before[k] = mean;
    for (int k = 0; k < count; k++) n->mean[k] = mean;
}

static void look_around(neighbours *n)
{
    const int64_t *p = n->before + 1;
    for (int k = 0; k < n->count; k++)
        n->around[k] = 4 * p[k] + 3 * (p[k - 1] + p[k + 1]) + 10 * n->mean[k];
}

/* ``before`` has the magnitudes of a block, times 256. */
static void learn_block(neighbours *n)
{
    int64_t *p = n->before + 1;
    for (int k = 0; k < n->count; k++) n->mean[k] += (p[k] - n->mean[k]) >> 2;
    p[-1] = p[0];
    p[n->count] = p[n->count - 1];
}

INLINE int context_by(int64_t mean, int *shift)
{
    int lg = bit_length((uint64_t)mean | 1) - 1, fr = (int)((mean << 2 >> lg) & 3);
    int low = lg < SCALED ? lg : SCALED, c = 4 * low + fr - 8;
    *shift = lg - low;
    return c < 0 ? 0 : c;
}

typedef struct {
    int size, count, classes, start;
    const double *waves;    /* [size / TILE][size][TILE] */
    const int16_t *pairs;   /* the same [size / TILE][size / 2][TILE][2], at most 32767 */
    int64_t step;           /* of all coefficients; 0: they have different ones */
    const int64_t *window;  /* [2][size / 2] */
    const int64_t *steps;   /* [count] */
    int64_t base, low, high, span;
} transform;

/* Coefficients that are not 0, and their places. levels: of all, in steps, where they are ``small``. */
typedef struct {
    int some, small;
    double x[SIZE_MOST];
    int places[SIZE_MOST];
    int16_t levels[SIZE_MOST];
} block;

/* next_state, three bits for each state and parity. */
static uint64_t packed_states(void)
{
    uint64_t all = 0;
    for (int s = 0; s < STATES; s++)
        for (int odd = 0; odd < 2; odd++) all |= (uint64_t)next_state[s][odd] << (6 * s + 3 * odd);
    return all;
}

static int get_coefficients(decoder *given, const transform *t, neighbours *n, int *state, block *b)
{
    const class_table *first = hapfmt_classes + (t->classes & 15);
    ptrdiff_t apart = (t->classes >> 4) - (t->classes & 15);
    const uint64_t following = packed_states();
    decoder copy = *given, *d = &copy;
    int64_t a1 = n->mean[0], a2 = a1, *before = n->before + 1;
    double total = 0;
    uint32_t s = (uint32_t)*state;
    int status = DONE, some = 0;
    int64_t levels = 0;
    look_around(n);
    memset(b->levels, 0, sizeof b->levels);
    for (int k = 0; k < t->count; k++) {
        int h, c = context_by((8 * a1 + (4 * a2 + n->around[k])) >> 5, &h), quantiser = (int)(s & 1);
        int symbol = get_one(d->x, first + (quantiser ? apart : 0), c, &d->next);
        uint64_t u = (uint64_t)symbol;
        /* Most numbers are their symbols: then nothing waits for raw bits. */
        if (h || symbol >= PLAIN_SYMBOLS) {
            if (RARE(symbol == ESCAPE)) {
                uint64_t word = raw_word(d->end, d->raw);
                int length = (int)(word & 63);
                u = ((uint64_t)1 << length | (word >> 6 & (((uint64_t)1 << length) - 1))) + edges[ESCAPE] - 1;
                d->raw += 6 + length;
                if (u >> (ERROR_BITS - h)) status = BAD_ERROR;
                else u = u << h | get_raw(d, h);
            } else
                u = ((uint64_t)edges[symbol] << h) + get_raw(d, extra[symbol] + h);
            if (u >> ERROR_BITS) status = BAD_ERROR;
            if (RARE(status)) break;
        }
        if (u) {
            int negative = (int)get_raw(d, 1);
            int64_t level = (int64_t)(2 * u) - quantiser;
            double x = (double)level * (double)t->steps[k];
            total += x;
            levels += level;
            b->levels[k] = (int16_t)(negative ? -level : level);
            b->x[some] = negative ? -x : x;
            b->places[some++] = k;
        }
        if (RARE(overrun(d) || total > SUM_LIMIT)) {
            status = overrun(d) ? BAD_END : BAD_SUM;
            break;
        }
        s = (uint32_t)(following >> (6 * s + 3 * (u & 1))) & 7;
        a2 = a1;
        a1 = (int64_t)(256 * u);
        before[k] = a1; /* the one behind it was looked at */
    }
    *given = copy;
    *state = (int)s;
    b->some = some;
    b->small = levels <= SMALL_LEVELS;
    if (!status) learn_block(n);
    return status;
}

/* v of TILE samples of a block: ``waves`` [size][TILE]. The sums stay in registers. */
INLINE void tile_as(const double *waves, const block *b, int64_t *v)
{
    double sums[TILE];
    for (int j = 0; j < TILE; j++) sums[j] = 1 << (COSINE_BITS - 1);
    for (int i = 0; i < b->some; i++) {
        const double *wave = waves + (size_t)b->places[i] * TILE;
        double x = b->x[i];
        for (int j = 0; j < TILE; j++) sums[j] += x * wave[j];
    }
    for (int j = 0; j < TILE; j++) v[j] = (int64_t)sums[j] >> COSINE_BITS;
}

typedef void tile_loop(const double *waves, const block *b, int64_t *v);

static void tile(const double *waves, const block *b, int64_t *v) { tile_as(waves, b, v); }

#ifdef WIDE
WIDE static void wide_tile(const double *waves, const block *b, int64_t *v)
{
    tile_as(waves, b, v);
}

static tile_loop *best_tile(void) { return wide() ? wide_tile : tile; }

/* What ``pairs`` lack of waves of 32768: those at -3 to 3 of the 4096 cosines. The odd numbers of
   coefficient and sample have a product of -3 to 3 (blocks of 512) or -1 to 1 (256), modulo 8 * size. */
static void add_peaks(const block *b, int size, int32_t *sums)
{
    const uint32_t end = size == SIZE_MOST ? 3 : 1, most = 8 * (uint32_t)size - 1;
    for (int i = 0; i < b->some; i++) {
        uint32_t odd = 2 * (uint32_t)b->places[i] + 1, inverse = odd * (2 - odd * odd);
        inverse *= 2 - odd * inverse;
        for (uint32_t peak = 0 - end; peak != end + 2; peak += 2) {
            uint32_t other = inverse * peak & most;
            if (other < 2 * (uint32_t)size) sums[other / 2] += b->levels[b->places[i]];
        }
    }
}

/* v of a block of small levels with one step: sums below 2^31, of two products at a time. */
WIDE static void small_block(const transform *t, const block *b, int64_t *v)
{
    int32_t sums[SIZE_MOST] = {0}, both[SIZE_MOST / 2];
    int places[SIZE_MOST / 2], some = 0;
    for (int i = 0; 2 * i < t->count; i++) {
        memcpy(both + some, b->levels + 2 * i, sizeof *both);
        places[some] = i;
        some += both[some] != 0;
    }
    if (t->size >= SIZE_MOST / 2) add_peaks(b, t->size, sums);
    for (int j = 0; j < t->size; j += TILE) {
        const int16_t *pairs = t->pairs + (size_t)j * (size_t)t->size;
        __m256i one = _mm256_loadu_si256((const __m256i *)(sums + j));
        __m256i two = _mm256_loadu_si256((const __m256i *)(sums + j + 8));
        for (int i = 0; i < some; i++) {
            const __m256i *pair = (const __m256i *)(pairs + (size_t)places[i] * 2 * TILE);
            __m256i levels = _mm256_set1_epi32(both[i]);
            one = _mm256_add_epi32(one, _mm256_madd_epi16(levels, _mm256_loadu_si256(pair)));
            two = _mm256_add_epi32(two, _mm256_madd_epi16(levels, _mm256_loadu_si256(pair + 1)));
        }
        _mm256_storeu_si256((__m256i *)(sums + j), one);
        _mm256_storeu_si256((__m256i *)(sums + j + 8), two);
    }
    for (int j = 0; j < t->size; j++)
        v[j] = (sums[j] * t->step + (1 << (COSINE_BITS - 1))) >> COSINE_BITS;
}

static int is_small(const transform *t, const block *b) { return t->step && b->small && wide(); }
#else
static void small_block(const transform *t, const block *b, int64_t *v) { (void)t, (void)b, (void)v; }

static int is_small(const transform *t, const block *b) { return (void)t, (void)b, 0; }

static tile_loop *best_tile(void) { return tile; }
#endif

/* v of some blocks, a row of SIZE_MOST for each: a tile of the waves serves all of them. */
static void transform_blocks(const transform *t, const block *blocks, int count, int64_t *v)
{
    tile_loop *loop = best_tile();
    int large[BATCH];
    for (int b = 0; b < count; b++) {
        int64_t *to = v + (size_t)b * SIZE_MOST;
        int small = is_small(t, blocks + b);
        large[b] = blocks[b].some && !small;
        if (!blocks[b].some) memset(to, 0, (size_t)t->size * sizeof *v);
        else if (small) small_block(t, blocks + b, to);
    }
    for (int j = 0; j < t->size; j += TILE)
        for (int b = 0; b < count; b++)
            if (large[b])
                loop(t->waves + (size_t)j * (size_t)t->size, blocks + b, v + (size_t)b * SIZE_MOST + j);
}

INLINE void put_count(const transform *t, int64_t at, int64_t x, int32_t *out)
{
    int64_t count = t->base + x;
    if (at < t->span) out[at] = (int32_t)(count < t->low ? t->low : count > t->high ? t->high : count);
}

/* Counts around p, where two blocks meet. */
static void mix(const transform *t, int64_t p, const int64_t *last, const int64_t *now, int32_t *out)
{
    int half = t->size / 2;
    const int64_t *w = t->window, *z = t->window + half;
    for (int i = 0; i < half; i++) {
        int64_t right = now[i], left = last[t->size - 1 - i];
        put_count(t, p + i, (w[i] * right - z[i] * left + (1 << 22)) >> 23, out);
        put_count(t, p - 1 - i, (w[i] * left + z[i] * right + (1 << 22)) >> 23, out);
    }
}

/* Where decoding works: coefficients of some blocks, and their v after that of the block before. */
typedef struct {
    block blocks[BATCH];
    int64_t v[(BATCH + 1) * SIZE_MOST];
    neighbours n;
} workbench;

/* ``in`` has a margin on both sides, and is used up. *taken: bytes. */
static inline int decode_transform(uint8_t *in, int64_t size, const transform *t, workbench *work, int32_t *out,
                            int64_t *taken)
{
    int64_t *first = work->v + SIZE_MOST, p = 0;
    int M = t->size, half = M / 2, state = 0, was = 0;
    decoder d;
    decoder_init(&d, in, 0, size, 1);
    neighbours_from(&work->n, M, t->count, t->start);
    int status = overrun(&d) ? BAD_END : DONE;
    while (!status && p < t->span) {
        int count = 0;
        for (int64_t at = p; !status && count < BATCH && at < t->span; at += M)
            status = get_coefficients(&d, t, &work->n, &state, work->blocks + count++);
        if (status) break;
        transform_blocks(t, work->blocks, count, first);
        for (int b = 0; b < count; b++, p += M) {
            const int64_t *now = first + (size_t)b * SIZE_MOST;
            int any = work->blocks[b].some;
            if (!p)
                for (int i = 0; i < half; i++) put_count(t, i, (now[i] + 128) >> 8, out);
            else if (any || was) mix(t, p, now - SIZE_MOST, now, out);
            else
                for (int i = -half; i < half; i++) put_count(t, p + i, 0, out);
            if (p + M >= t->span)
                for (int i = half; i < M; i++) put_count(t, p + i, (now[i] + 128) >> 8, out);
            was = any;
        }
        memcpy(work->v, first + (size_t)(count - 1) * SIZE_MOST, (size_t)M * sizeof *work->v);
    }
    if (!status) status = check_end(&d);
    *taken = front_taken(&d);
    return status;
}

#endif
