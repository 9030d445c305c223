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

/* Where a way came from, which is its state or that four further, and its magnitude. */
typedef struct { uint8_t from[STATES]; int64_t u[STATES]; } column;

/* A magnitude worth trying: its squared error, and what it takes where contexts do not scale it. */
typedef struct { int64_t u, error, taken; int symbol; } option;

static const int64_t NEVER = (int64_t)1 << 60;

INLINE option option_of(int64_t target, int64_t u, int quantiser, int64_t weight)
{
    int64_t level = 2 * u - quantiser, error = target - SCALED_STEP * (level > 0 ? level : 0);
    option o = {u, error * error, 0, magnitude_symbol((uint64_t)u)};
    o.taken = o.error + weight * 256 * rest_bits(u, (uint64_t)u, o.symbol, 0);
    return o;
}

INLINE int64_t cost_of_option(const option *o, const uint16_t *costs, int h, int64_t weight)
{
    uint64_t w = (uint64_t)o->u >> h;
    int k;
    if (!RARE(h)) return o->taken + weight * costs[o->symbol];
    k = magnitude_symbol(w);
    return o->error + weight * (costs[k] + 256 * rest_bits(o->u, w, k, h));
}

/* The options of a quantiser, by parity: one or two of each. */
typedef struct { option of[2][2]; int some[2]; } choice;

static void choose(int64_t target, int quantiser, int64_t weight, choice *c)
{
    int64_t low = (target + SCALED_STEP * quantiser) / (2 * SCALED_STEP);
    int even = low & 1;
    c->of[even][0] = option_of(target, low, quantiser, weight);
    c->of[!even][0] = option_of(target, low + 1, quantiser, weight);
    c->some[0] = c->some[1] = 1;
    if (low > 0) c->of[!even][c->some[!even]++] = option_of(target, low - 1, quantiser, weight);
    if (low == 2) c->of[even][c->some[even]++] = option_of(target, 0, quantiser, weight);
}

typedef struct { int64_t cost, u; } step;

INLINE step best_option(const choice *c, int odd, const uint16_t *costs, int h, int64_t weight)
{
    const option *o = c->of[odd];
    step best = {cost_of_option(o, costs, h, weight), o->u};
    if (c->some[odd] > 1) {
        int64_t other = cost_of_option(o + 1, costs, h, weight);
        if (other < best.cost) {
            best.cost = other;
            best.u = o[1].u;
        }
    }
    return best;
}

/* Magnitudes of a block that begins in a state. States s and s + 4 lead to the same two. */
static void quantise_block(const neighbours *n, const class_table *const *tables, const int64_t *row,
                           int state, int64_t weight, column *columns, int64_t *out)
{
    survivor ways[STATES], after[STATES];
    int best = 0, count = n->count;
    for (int s = 0; s < STATES; s++) {
        ways[s].cost = s == state ? 0 : NEVER;
        ways[s].a1 = ways[s].a2 = n->mean[0];
    }
    for (int k = 0; k < count; k++) {
        choice choices[2];
        step steps[STATES][2];
        for (int q = 0; q < 2; q++) choose(row[k], q, weight, choices + q);
        for (int s = 0; s < STATES; s++) {
            int h, c = context_by((8 * ways[s].a1 + 4 * ways[s].a2 + n->around[k]) >> 5, &h);
            const uint16_t *costs = tables[s & 1]->costs[c];
            for (int odd = 0; odd < 2; odd++) {
                steps[s][odd] = best_option(choices + (s & 1), odd, costs, h, weight);
                steps[s][odd].cost += ways[s].cost;
            }
        }
        for (int s = 0; s < STATES / 2; s++)
            for (int odd = 0; odd < 2; odd++) {
                const step *one = &steps[s][odd], *two = &steps[s + 4][!odd];
                int to = next_state[s][odd], second = two->cost < one->cost, from = s + 4 * second;
                const step *taken = second ? two : one;
                after[to].cost = taken->cost;
                after[to].a1 = 256 * taken->u;
                after[to].a2 = ways[from].a1;
                columns[k].from[to] = (uint8_t)from;
                columns[k].u[to] = taken->u;
            }
        memcpy(ways, after, sizeof ways);
    }
    for (int s = 1; s < STATES; s++)
        if (ways[s].cost < ways[best].cost) best = s;
    for (int k = count - 1; k >= 0; k--) {
        out[k] = columns[k].u[best];
        best = columns[k].from[best];
    }
}

/* Squared errors, and 256 times the bits. */
typedef struct { int64_t errors, bits; } spent;

/* What the decoder does with the magnitudes of a block: counts their symbols, adds up what they cost, and
   returns the state. */
static int follow(neighbours *n, const class_table *const *tables, const int64_t *targets, const int64_t *out,
                  int state, int64_t *seen, spent *total)
{
    int64_t a1 = n->mean[0], a2 = a1, *before = n->before + 1;
    for (int k = 0; k < n->count; k++) {
        int h, c = context_by((8 * a1 + 4 * a2 + n->around[k]) >> 5, &h), quantiser = state & 1;
        int64_t level = 2 * out[k] - quantiser, error = targets[k] - SCALED_STEP * (level > 0 ? level : 0);
        uint64_t w = (uint64_t)out[k] >> h;
        int symbol = magnitude_symbol(w);
        seen[(quantiser * CONTEXTS + c) * SYMBOLS + symbol]++;
        total->errors += error * error;
        total->bits += tables[quantiser]->costs[c][symbol] + 256 * rest_bits(out[k], w, symbol, h);
        state = next_state[state][out[k] & 1];
        a2 = a1;
        a1 = before[k] = 256 * out[k];
    }
    learn_block(n);
    return state;
}

static spent run_trellis(neighbours *n, const class_table *const *tables, const int64_t *targets,
                         int64_t blocks, int64_t weight, column *columns, int64_t *out, int64_t *seen)
{
    int state = 0;
    spent total = {0, 0};
    for (int64_t b = 0; b < blocks; b++, targets += n->count, out += n->count) {
        int64_t most = 0;
        look_around(n);
        for (int k = 0; k < n->count; k++)
            if (targets[k] > most) most = targets[k];
        if (most < SCALED_STEP / 2) memset(out, 0, (size_t)n->count * sizeof *out);
        else quantise_block(n, tables, targets, state, weight, columns, out);
        state = follow(n, tables, targets, out, state, seen, &total);
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
