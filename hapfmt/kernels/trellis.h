/* The encoder of SPEC 9.8: magnitudes by a trellis of eight states, and their coded bytes. The readable
   twins are hapfmt/encoder/transform.py and encode_levels() of hapfmt/codecs/transform.py.

   Errors are below 2^11 and bits below 2^15, in 256ths; a block of 512 of them stays far below 2^63. */
#ifndef HAPFMT_TRELLIS_H
#define HAPFMT_TRELLIS_H

#include "transform.h"

enum { TARGET_BITS = 42, SCALED_STEP = 256, WEIGHT_MOST = 1 << 20, CODES = 2 * CONTEXTS * SYMBOLS };

INLINE int magnitude_symbol(uint64_t w) { return w >= edges[ESCAPE] ? ESCAPE : buckets[w]; }

/* Raw bits of a magnitude, shifted to w, with symbol k, and its sign. */
INLINE int rest_bits(int64_t u, uint64_t w, int k, int h)
{
    return h + (k == ESCAPE ? 5 + bit_length(w - edges[ESCAPE] + 1) : extra[k]) + (u > 0);
}

typedef struct { int64_t cost, a1, a2; } survivor;

/* Where a way came from, and its magnitude. */
typedef struct { int32_t from[STATES]; int64_t u[STATES]; } column;

INLINE void try_one(const survivor *way, int s, int64_t target, int64_t u, const uint16_t *costs, int h,
                    int64_t weight, survivor *after, column *at)
{
    int quantiser = s & 1, to = next_state[s][u & 1];
    int64_t level = 2 * u - quantiser, error = target - SCALED_STEP * (level > 0 ? level : 0);
    uint64_t w = (uint64_t)u >> h;
    int k = magnitude_symbol(w);
    int64_t cost = way->cost + error * error + weight * (costs[k] + 256 * rest_bits(u, w, k, h));
    if (after[to].cost >= 0 && cost >= after[to].cost) return;
    after[to].cost = cost;
    after[to].a1 = 256 * u;
    after[to].a2 = way->a1;
    at->from[to] = s;
    at->u[to] = u;
}

/* Magnitudes of a block that begins in a state. */
static void quantise_block(const neighbours *n, const class_table *const *tables, const int64_t *row,
                           int state, int64_t weight, column *columns, int64_t *out)
{
    survivor ways[STATES], after[STATES];
    int best = -1, count = n->count;
    for (int s = 0; s < STATES; s++) ways[s].cost = -1;
    ways[state].cost = 0;
    ways[state].a1 = ways[state].a2 = n->mean[0];
    for (int k = 0; k < count; k++) {
        for (int s = 0; s < STATES; s++) after[s].cost = -1;
        for (int s = 0; s < STATES; s++) {
            const survivor *way = ways + s;
            if (way->cost < 0) continue;
            int h, c = context_by((8 * way->a1 + 4 * way->a2 + n->around[k]) >> 5, &h);
            const uint16_t *costs = tables[s & 1]->costs[c];
            int64_t low = (row[k] + SCALED_STEP * (s & 1)) / (2 * SCALED_STEP);
            try_one(way, s, row[k], low, costs, h, weight, after, columns + k);
            try_one(way, s, row[k], low + 1, costs, h, weight, after, columns + k);
            if (low > 0) try_one(way, s, row[k], low - 1, costs, h, weight, after, columns + k);
            if (low == 2) try_one(way, s, row[k], 0, costs, h, weight, after, columns + k);
        }
        memcpy(ways, after, sizeof ways);
    }
    for (int s = 0; s < STATES; s++)
        if (ways[s].cost >= 0 && (best < 0 || ways[s].cost < ways[best].cost)) best = s;
    for (int k = count - 1; k >= 0; k--) {
        out[k] = columns[k].u[best];
        best = columns[k].from[best];
    }
}

/* What the decoder does with the magnitudes of a block: counts their symbols, adds up what they cost, and
   returns the state. */
static int follow(neighbours *n, const class_table *const *tables, const int64_t *targets, const int64_t *out,
                  int state, int64_t weight, int64_t *seen, int64_t *total)
{
    int64_t a1 = n->mean[0], a2 = a1, *before = n->before + 1;
    for (int k = 0; k < n->count; k++) {
        int h, c = context_by((8 * a1 + 4 * a2 + n->around[k]) >> 5, &h), quantiser = state & 1;
        int64_t level = 2 * out[k] - quantiser, error = targets[k] - SCALED_STEP * (level > 0 ? level : 0);
        uint64_t w = (uint64_t)out[k] >> h;
        int symbol = magnitude_symbol(w);
        seen[(quantiser * CONTEXTS + c) * SYMBOLS + symbol]++;
        *total += error * error +
                  weight * (tables[quantiser]->costs[c][symbol] + 256 * rest_bits(out[k], w, symbol, h));
        state = next_state[state][out[k] & 1];
        a2 = a1;
        a1 = before[k] = 256 * out[k];
    }
    learn_block(n);
    return state;
}

/* Returns the squared errors, and the bits times the weight. */
static int64_t run_trellis(neighbours *n, const class_table *const *tables, const int64_t *targets,
                           int64_t blocks, int64_t weight, column *columns, int64_t *out, int64_t *seen)
{
    int state = 0;
    int64_t total = 0;
    for (int64_t b = 0; b < blocks; b++, targets += n->count, out += n->count) {
        int64_t most = 0;
        look_around(n);
        for (int k = 0; k < n->count; k++)
            if (targets[k] > most) most = targets[k];
        if (most < SCALED_STEP / 2) memset(out, 0, (size_t)n->count * sizeof *out);
        else quantise_block(n, tables, targets, state, weight, columns, out);
        state = follow(n, tables, targets, out, state, weight, seen, &total);
    }
    return total;
}

/* The coded bytes: how many, or how many it takes. ``codes`` and ``words`` have room for all symbols. */
static int64_t put_levels(neighbours *n, const class_table *const *tables, const int64_t *levels,
                          int64_t blocks, uint16_t *codes, uint16_t *words, share *shares, uint8_t *out,
                          int64_t size)
{
    encoder e;
    int state = 0;
    encoder_init(&e, codes, out, size);
    memcpy(shares, tables[0]->shares, sizeof tables[0]->shares);
    memcpy(shares + CODES / 2, tables[1]->shares, sizeof tables[1]->shares);
    note(&e, SECTION);
    for (int64_t b = 0; b < blocks; b++, levels += n->count) {
        int64_t a1 = n->mean[0], a2 = a1, *before = n->before + 1;
        look_around(n);
        for (int k = 0; k < n->count; k++) {
            int h, c = context_by((8 * a1 + 4 * a2 + n->around[k]) >> 5, &h);
            uint64_t u = (uint64_t)(levels[k] < 0 ? -levels[k] : levels[k]), w = u >> h;
            int symbol = magnitude_symbol(w);
            note(&e, (state & 1) * (CODES / 2) + c * SYMBOLS + symbol);
            if (RARE(symbol == ESCAPE)) {
                uint64_t y = w - edges[ESCAPE] + 1;
                int length = bit_length(y) - 1;
                put_raw(&e, (uint64_t)length, 6);
                put_raw(&e, y, length);
                put_raw(&e, u, h);
            } else
                put_raw(&e, u - ((uint64_t)edges[symbol] << h), extra[symbol] + h);
            if (u) put_raw(&e, levels[k] < 0, 1);
            state = next_state[state][u & 1];
            a2 = a1;
            a1 = before[k] = (int64_t)(256 * u);
        }
        learn_block(n);
    }
    return encoder_finish(&e, shares, 1, words);
}

#endif
