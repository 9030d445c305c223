/* What the makers and readers of coded bytes share: memory to work in, bits and signs with
   probabilities of their own. The readable twin is hapfmt/codecs/entropy.py. */
#ifndef HAPFMT_CODED_H
#define HAPFMT_CODED_H

#include <math.h>
#include <stdlib.h>

#include "integers.h"

enum { BAD_CODING = 6, NO_MEMORY = 9 };

/* Bytes with a margin of zeros on both sides; NULL where memory ran out. */
static uint8_t *with_margins(const void *bytes, int64_t size)
{
    uint8_t *copy = malloc((size_t)(size + 2 * MARGIN));
    if (!copy) return NULL;
    memset(copy, 0, MARGIN);
    memcpy(copy + MARGIN, bytes, (size_t)size);
    memset(copy + MARGIN + size, 0, MARGIN);
    return copy;
}

/* Where a packet is made: codes of its symbols and their words, three for each number and a few, and the numbers. */
typedef struct {
    uint16_t *codes, *words;
    int64_t *errors;
} workshop;

static int workshop_open(workshop *w, int64_t span)
{
    w->codes = malloc((size_t)(2 * (3 * span + 8)));
    w->words = malloc((size_t)(2 * (3 * span + 16)));
    w->errors = malloc((size_t)(8 * (span + 1)));
    return w->codes && w->words && w->errors;
}

static void workshop_close(workshop *w)
{
    free(w->codes);
    free(w->words);
    free(w->errors);
}

/* 256 times the bits of what has this probability in 256ths. */
static int64_t bit_cost(int p) { return (int64_t)floor(256 * log2(256.0 / p) + 0.5); }

/* The probabilities of bits that were counted, into a packet and as shares. */
static int put_bits(share *shares, uint8_t *out, const int64_t *counts, int contexts)
{
    for (int i = 0; i < contexts; i++) {
        int p = probability_of(counts[2 * i], counts[2 * i + 1]);
        out[i] = (uint8_t)p;
        shares[2 * i] = bit_share(0, p);
        shares[2 * i + 1] = bit_share(1, p);
    }
    return contexts;
}

/* Whether probabilities of signs save more than they take; how many there are of each. */
static int signs_pay(const int64_t *numbers, int64_t count, int64_t *counts)
{
    int64_t cost = 256 * 8 * SIGN_CONTEXTS, raw = 0;
    int last = 0;
    memset(counts, 0, 2 * SIGN_CONTEXTS * sizeof *counts);
    for (int64_t i = 0; i < count; i++) {
        int sign = (numbers[i] > 0) - (numbers[i] < 0);
        counts[2 * last + 2 + (sign < 0)] += sign != 0;
        last = sign;
    }
    for (int i = 0; i < SIGN_CONTEXTS; i++) {
        int64_t zeros = counts[2 * i], ones = counts[2 * i + 1];
        int p = probability_of(zeros, ones);
        raw += zeros + ones;
        cost += zeros * bit_cost(256 - p) + ones * bit_cost(p);
    }
    return cost < 256 * raw;
}

static void note_signs(encoder *e, const int64_t *numbers, int64_t count, int codes)
{
    int last = 0;
    note(e, SECTION);
    for (int64_t i = 0; i < count; i++) {
        int sign = (numbers[i] > 0) - (numbers[i] < 0);
        if (sign) note(e, codes + 2 * (last + 1) + (sign < 0));
        last = sign;
    }
}

#endif
