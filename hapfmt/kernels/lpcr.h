/* The loops of SPEC 9.5 over the samples of a packet. The readable twin is hapfmt/codecs/predicted.py.

   What keeps every signed sum within 64 bits, whatever the bytes say: valid() admits |base| <= limit
   <= 2^32, |c| <= 2^21, at most 32 of them, g <= 1 with them, and cross terms of at most 2^54; each
   |e| < 2^34 and each |index| <= limit is checked before it is used. So |z| <= 2^33; its i-th
   differences 2^37; with coefficients |y| <= 2^34, predictions 2^5 * 2^21 * 2^34 = 2^60 before the
   shift, and y[t] 2^55 before the index is checked. Negative numbers are shifted to
   the right only, which rounds down on every compiler that builds CPython. */
#ifndef HAPFMT_LPCR_H
#define HAPFMT_LPCR_H

#include "flags.h"

enum { ORDERS = 32, DIFFERENCES = 4, SHIFT = 13, COEFFICIENT_LIMIT = 1 << 21 };
enum { RING = 1024, PIECE = 1024, UNROLLED = 12, STEP = 8 };
enum { REPEAT_CONTEXTS = 4, BY_BITS = 64, REPEAT_CODES = BITS, SIGN_CODES = BITS + 2 * REPEAT_CONTEXTS };
static const int64_t INDEX_LIMIT = (int64_t)1 << 32, CROSS_LIMIT = (int64_t)1 << 54;

typedef struct {
    int difference, order, repeats, ready; /* ready: the errors are there */
    int64_t base, limit, span;
    const int32_t *coefficients;
    const int64_t *cross; /* what other components say of each sample, or NULL */
} plan;

/* How symbols are coded: the byte of SPEC 9.5 that says so, and the probabilities behind it. */
typedef struct {
    int by_bits, class, lanes, signs, start;
    uint8_t repeats[REPEAT_CONTEXTS], sign[SIGN_CONTEXTS];
} coding;

/* Coefficients, the oldest sample's first, after zeros that make their number a multiple of 8. Sums of
   doubles are exact in any order where ``real`` says that they stay below 2^53. */
typedef struct {
    double real_taps[ORDERS];
    int64_t taps[ORDERS];
    int width, real;
} filter;

static int valid(const plan *p)
{
    int fits = p->order <= ORDERS && p->difference >= 0 &&
               p->difference <= (p->order ? 1 : DIFFERENCES) && p->limit >= 0 &&
               p->limit <= INDEX_LIMIT && p->base <= p->limit && p->base >= -p->limit;
    for (int j = 0; fits && j < p->order; j++)
        fits = p->coefficients[j] <= COEFFICIENT_LIMIT && p->coefficients[j] >= -COEFFICIENT_LIMIT;
    return fits;
}

static int within(const int64_t *indices, int64_t count, int64_t limit)
{
    /* The highest bit is set where one of them leaves the range, or 64 bits. */
    uint64_t beyond = 0, bound = (uint64_t)limit;
    for (int64_t t = 0; t < count; t++)
        beyond |= ((uint64_t)indices[t] + bound) | (bound - (uint64_t)indices[t]);
    return !(beyond >> 63);
}

static void filter_init(filter *f, const plan *p)
{
    int64_t sum = 0, largest = 2 * p->limit;
    memset(f, 0, sizeof *f);
    f->width = (p->order + 7) & ~7;
    for (int j = 0; j < p->order; j++) {
        int64_t c = p->coefficients[j];
        f->taps[f->width - 1 - j] = c;
        f->real_taps[f->width - 1 - j] = (double)c;
        sum += c < 0 ? -c : c;
    }
    f->real = sum * largest < (int64_t)1 << 52;
}

/* ``next`` points behind the newest sample. */
INLINE int64_t predict(const filter *f, const int64_t *next)
{
    int64_t sum = (int64_t)1 << (SHIFT - 1);
    next -= f->width;
    for (int j = 0; j < f->width; j++) sum += f->taps[j] * next[j];
    return sum >> SHIFT;
}

/* c[1..m] of SPEC 9.5; 0 where LPC-005 is broken. Twice a product stays below 2^53. */
static int step_up(const int8_t *reflections, int order, const int32_t *sines, int32_t *out)
{
    int64_t p[ORDERS], before[ORDERS];
    for (int n = 0; n < order; n++) {
        int at = reflections[n];
        int64_t k = at < 0 ? -sines[-at] : sines[at];
        memcpy(before, p, (size_t)n * sizeof *p);
        for (int j = 0; j < n; j++) p[j] = before[j] - ((2 * k * before[n - 1 - j] + (1 << 15)) >> 16);
        p[n] = k * 32;
        for (int j = 0; j <= n; j++)
            if (p[j] > (int64_t)1 << 36 || p[j] < -((int64_t)1 << 36)) return 0;
    }
    for (int j = 0; j < order; j++) {
        int64_t c = (2 * p[j] + 128) >> 8;
        if (c > COEFFICIENT_LIMIT || c < -COEFFICIENT_LIMIT) return 0;
        out[j] = (int32_t)c;
    }
    return 1;
}

/* ---- decoding ---- */

/* Turns the prediction errors in ``out`` into indices, sample by sample. ``some``: there are
   coefficients. */
INLINE int synthesise_as(const plan *p, const filter *f, const uint8_t *same, int64_t *out, int some,
                         int repeats, int g)
{
    int64_t sums[DIFFERENCES + 1] = {0}, history[ORDERS + RING];
    if (some) memset(history, 0, sizeof history);
    int now = ORDERS;
    int64_t base = p->base, limit = p->limit;
    for (int64_t t = 0; t < p->span; t++) {
        if (repeats && same[t]) {
            int64_t fresh = sums[0], older;
            for (int i = 1; i <= g; i++) {
                older = sums[i - 1];
                sums[i - 1] = fresh;
                fresh -= older;
            }
            sums[g] = fresh;
        } else {
            int64_t fresh = out[t];
            if (some) fresh += predict(f, history + now);
            sums[g] = fresh;
            for (int i = g - 1; i >= 0; i--) {
                fresh += sums[i];
                sums[i] = fresh;
            }
        }
        int64_t index = sums[0] + base;
        if (RARE(index > limit || index < -limit)) return BAD_INDEX;
        out[t] = index;
        if (some) {
            history[now] = sums[g];
            if (++now == ORDERS + RING) {
                memcpy(history, history + RING, ORDERS * sizeof *history);
                now = ORDERS;
            }
        }
    }
    return DONE;
}

/* Predictions of STEP samples from all that come before the first of them, eight taps at a time. All
   sums are integers below 2^53: their order does not matter. */
#if defined(__GNUC__) && !defined(HAPFMT_PLAIN)
typedef double four __attribute__((vector_size(32)));
#endif

/* ``c``: coefficients [width], the newest sample's first, and STEP zeros; ``next`` points behind the
   newest sample. */
INLINE void predict_step(const double *c, const double *next, int width, int64_t *sums)
{
    const double half = 1 << (SHIFT - 1);
#if defined(__GNUC__) && !defined(HAPFMT_PLAIN)
    four a = {half, half, half, half}, b = a, d = {0}, e = {0};
    for (int j = width - 1; j >= 0; j -= 2) {
        four old, new, older, newer;
        memcpy(&old, c + j, sizeof old);
        memcpy(&older, c + j + 4, sizeof older);
        memcpy(&new, c + j - 1, sizeof new);
        memcpy(&newer, c + j + 3, sizeof newer);
        a += old * next[-1 - j];
        b += older * next[-1 - j];
        d += new * next[-j];
        e += newer * next[-j];
    }
    a += d;
    b += e;
    for (int i = 0; i < 4; i++) {
        sums[i] = (int64_t)a[i];
        sums[4 + i] = (int64_t)b[i];
    }
#else
    double a[STEP];
    for (int i = 0; i < STEP; i++) a[i] = half;
    for (int j = width - 1; j >= 0; j--)
        for (int i = 0; i < STEP; i++) a[i] += c[j + i] * next[-1 - j];
    for (int i = 0; i < STEP; i++) sums[i] = (int64_t)a[i];
#endif
}

/* Where a synthesis in steps is: ``history`` has y before ``now``. */
typedef struct {
    double c[ORDERS + STEP], history[ORDERS + RING];
    int64_t taps[STEP];
    uint64_t last, base, kept, limit;
    int now, width;
} steps;

/* A step: the history counts by vectors of doubles, what is new within the step by integers, whose
   products take less time to arrive. Unsigned sums may wrap: indices beyond the limit are found after the step. */
INLINE void take_step(steps *s, const uint8_t *same, int64_t *out, int repeats)
{
    int64_t sums[STEP];
    uint64_t y[STEP];
    predict_step(s->c, s->history + s->now, s->width, sums);
    UNROLL
    for (int i = 0; i < STEP; i++) {
        uint64_t sum = (uint64_t)sums[i];
        UNROLL
        for (int j = i; j > 0; j--) sum += (uint64_t)s->taps[j - 1] * y[i - j];
        y[i] = (uint64_t)out[i] + (uint64_t)((int64_t)sum >> SHIFT);
        if (repeats && same[i]) y[i] = s->last & ~s->kept;
        s->last = (s->last & s->kept) + y[i];
        out[i] = (int64_t)(s->last + s->base);
        s->history[s->now + i] = (double)(int64_t)y[i];
    }
    s->now += STEP;
    if (s->now > ORDERS + RING - STEP) {
        memcpy(s->history, s->history + s->now - ORDERS, ORDERS * sizeof *s->history);
        s->now = ORDERS;
    }
}

/* As synthesise_as, in steps of eight samples. */
INLINE int synthesise_steps(const plan *p, int width, const uint8_t *same, int64_t *out, int repeats)
{
    steps s;
    int64_t t = 0, left = p->span % STEP, rest[STEP] = {0};
    uint8_t none[STEP] = {0};
    memset(s.c, 0, sizeof s.c);
    memset(s.taps, 0, sizeof s.taps);
    for (int j = 0; j < p->order; j++) s.c[j] = p->coefficients[j];
    for (int j = 0; j < STEP && j < p->order; j++) s.taps[j] = p->coefficients[j];
    memset(s.history, 0, ORDERS * sizeof *s.history);
    s.last = 0;
    s.base = (uint64_t)p->base;
    s.kept = p->difference ? UINT64_MAX : 0;
    s.now = ORDERS;
    s.width = width;
    for (; t + STEP <= p->span; t += STEP) {
        take_step(&s, repeats ? same + t : NULL, out + t, repeats);
        if (RARE(!within(out + t, STEP, p->limit))) return BAD_INDEX;
    }
    if (!left) return DONE;
    memcpy(rest, out + t, (size_t)left * sizeof *rest);
    if (repeats) memcpy(none, same + t, (size_t)left);
    take_step(&s, none, rest, repeats);
    memcpy(out + t, rest, (size_t)left * sizeof *rest);
    return within(rest, left, p->limit) ? DONE : BAD_INDEX;
}

/* Few coefficients and no repeats: the history stays in registers. */
INLINE int synthesise_short(const plan *p, int64_t *out, int order, int g)
{
    int64_t c[UNROLLED], y[UNROLLED], last = 0, base = p->base, limit = p->limit;
    for (int j = 0; j < order; j++) {
        c[j] = p->coefficients[j];
        y[j] = 0;
    }
    for (int64_t t = 0; t < p->span; t++) {
        int64_t sum = (int64_t)1 << (SHIFT - 1);
        for (int j = order - 1; j >= 0; j--) sum += c[j] * y[j];
        for (int j = order - 1; j > 0; j--) y[j] = y[j - 1];
        y[0] = out[t] + (sum >> SHIFT);
        last = g ? last + y[0] : y[0];
        int64_t index = last + base;
        if (RARE(index > limit || index < -limit)) return BAD_INDEX;
        out[t] = index;
    }
    return DONE;
}

#define SHORT(m) \
    case m: return p->difference ? synthesise_short(p, out, m, 1) : synthesise_short(p, out, m, 0);

static int synthesise_unrolled(const plan *p, int64_t *out)
{
    switch (p->order) {
        SHORT(1) SHORT(2) SHORT(3) SHORT(4) SHORT(5) SHORT(6)
        SHORT(7) SHORT(8) SHORT(9) SHORT(10) SHORT(11) SHORT(12)
        default: return BAD_INDEX;
    }
}

static int synthesise_polynomial(const plan *p, int64_t *out)
{
    switch (p->difference) {
        case 0: return synthesise_as(p, NULL, NULL, out, 0, 0, 0);
        case 1: return synthesise_as(p, NULL, NULL, out, 0, 0, 1);
        case 2: return synthesise_as(p, NULL, NULL, out, 0, 0, 2);
        case 3: return synthesise_as(p, NULL, NULL, out, 0, 0, 3);
        default: return synthesise_as(p, NULL, NULL, out, 0, 0, 4);
    }
}

#define STEPS(name, target)                                                                       \
    target static int name(const plan *p, int width, const uint8_t *same, int64_t *out)           \
    {                                                                                             \
        return p->repeats ? synthesise_steps(p, width, same, out, 1)                              \
                          : synthesise_steps(p, width, same, out, 0);                             \
    }

STEPS(synthesise_real, )
#ifdef WIDE
STEPS(synthesise_wide, WIDE)
#endif

static int synthesise(const plan *p, const uint8_t *same, int64_t *out)
{
    filter f;
    if (!p->repeats && !p->order) return synthesise_polynomial(p, out);
    if (!p->repeats && p->order <= UNROLLED) return synthesise_unrolled(p, out);
    filter_init(&f, p);
    return !p->order ? synthesise_as(p, &f, same, out, 0, 1, p->difference)
#ifdef WIDE
           : f.real && wide() ? synthesise_wide(p, f.width, same, out)
#endif
           : f.real  ? synthesise_real(p, f.width, same, out)
                     : synthesise_as(p, &f, same, out, 1, p->repeats, p->difference);
}

/* What the coded bytes begin with, and the bytes it takes; 0 where it is not defined. */
static int take_coding(const uint8_t *in, int64_t size, int repeats, coding *c)
{
    c->by_bits = size && in[0] == BY_BITS;
    int count = c->by_bits ? 1 : 2;
    if (size < count || (!c->by_bits && (in[0] >> 6 || in[1] > START_MOST))) return 0;
    c->start = in[1];
    c->class = in[0] & 15;
    c->lanes = in[0] & 16 ? 4 : 1;
    c->signs = in[0] & 32 ? LATER_SIGNS : RAW_SIGNS;
    int some = (repeats ? REPEAT_CONTEXTS : 0) + (c->signs == LATER_SIGNS ? SIGN_CONTEXTS : 0);
    if (size < count + some) return 0;
    for (int i = count; i < count + some; i++)
        if (!in[i]) return 0;
    if (repeats) {
        memcpy(c->repeats, in + count, REPEAT_CONTEXTS);
        count += REPEAT_CONTEXTS;
    }
    if (c->signs == LATER_SIGNS) {
        memcpy(c->sign, in + count, SIGN_CONTEXTS);
        count += SIGN_CONTEXTS;
    }
    return count;
}

/* ``same`` [span]: which repeat the sample before; how many do not, or a status below 0. */
static int64_t get_repeats(decoder *d, const coding *c, int64_t span, uint8_t *same)
{
    int recent = 0, lane = 0;
    int64_t fresh = 1;
    same[0] = 0;
    for (int64_t t = 1; t < span; t++) {
        same[t] = (uint8_t)get_bit(d, lane, c->repeats[recent]);
        lane = (lane + 1) & (d->lanes - 1);
        if (RARE(overrun(d))) return -BAD_END;
        recent = 2 * same[t] + (recent >> 1);
        fresh += !same[t];
    }
    return fresh;
}

/* ``in`` has a margin on both sides, and is used up; ``same`` [span] where there are repeats. *taken: bytes. */
static int decode(uint8_t *in, int64_t size, const plan *p, uint8_t *same, int64_t *out,
                  int64_t *taken)
{
    coding c;
    decoder d;
    int64_t fresh = p->span;
    int head = take_coding(in, size, p->repeats, &c);
    *taken = 0;
    if (!head) return BAD_CODING;
    decoder_init(&d, in, head, size, c.lanes);
    int status = overrun(&d) ? BAD_END : DONE;
    if (!status && p->repeats) {
        fresh = get_repeats(&d, &c, p->span, same);
        if (fresh < 0) status = (int)-fresh;
    }
    int64_t *errors = out + p->span - fresh;
    if (!status)
        status = c.by_bits ? get_by_bits(&d, fresh, errors, RAW_SIGNS)
                           : get_integers(&d, c.class, c.start, fresh, errors, c.signs);
    if (!status && c.signs == LATER_SIGNS) status = get_signs(&d, c.sign, fresh, errors);
    if (!status) status = check_end(&d);
    *taken = head + front_taken(&d);
    if (status) return status;
    if (p->repeats)
        for (int64_t t = 0; t < p->span; t++)
            if (!same[t]) out[t] = *errors++;
    if (p->cross)
        for (int64_t t = 0; t < p->span; t++) out[t] += p->cross[t];
    return synthesise(p, same, out);
}

/* ---- encoding ---- */

/* y of a piece after the ORDERS ones before it: differences of indices[from] ... of the packet. */
INLINE void differences(const int64_t *indices, int64_t from, int64_t count, int g, int64_t base,
                        int64_t *y)
{
    int64_t z[PIECE + DIFFERENCES];
    for (int64_t i = -g; i < count; i++) z[i + g] = from + i < 0 ? 0 : indices[from + i] - base;
    for (int order = g; order > 0; order--)
        for (int64_t i = 0; i < count + order - 1; i++) z[i] = z[i + 1] - z[i];
    memcpy(y, z, (size_t)count * sizeof *y);
}

/* Prediction errors of a piece; y [ORDERS + count], the history first. */
INLINE void errors_of(const filter *f, const int64_t *y, int64_t count, int64_t *e)
{
    if (!f->width) {
        memcpy(e, y + ORDERS, (size_t)count * sizeof *e);
    } else if (f->real) {
        double real[ORDERS + PIECE], sums[PIECE];
        for (int64_t i = 0; i < ORDERS + count; i++) real[i] = (double)y[i];
        for (int64_t i = 0; i < count; i++) sums[i] = 1 << (SHIFT - 1);
        for (int j = 0; j < f->width; j += 4) {
            const double *x = real + ORDERS - f->width + j, *c = f->real_taps + j;
            for (int64_t i = 0; i < count; i++)
                sums[i] += (c[0] * x[i] + c[1] * x[i + 1]) + (c[2] * x[i + 2] + c[3] * x[i + 3]);
        }
        for (int64_t i = 0; i < count; i++) e[i] = y[ORDERS + i] - ((int64_t)sums[i] >> SHIFT);
    } else
        for (int64_t i = 0; i < count; i++) e[i] = y[ORDERS + i] - predict(f, y + ORDERS + i);
}

/* Prediction errors of all indices, no matter which of them are coded. */
static void prediction_errors(const plan *p, const int64_t *indices, int64_t *out)
{
    filter f;
    int64_t y[ORDERS + PIECE] = {0};
    filter_init(&f, p);
    for (int64_t from = 0; from < p->span; from += PIECE) {
        int64_t count = p->span - from < PIECE ? p->span - from : PIECE;
        differences(indices, from, count, p->difference, p->base, y + ORDERS);
        errors_of(&f, y, count, out + from);
        memmove(y, y + count, ORDERS * sizeof *y);
    }
}

/* Prediction errors of samples that do not repeat; the bits that say so are noted and counted. */
INLINE int64_t errors_and_repeats(encoder *e, const plan *p, const int64_t *indices, int64_t *errors,
                                  int64_t *counts)
{
    int64_t fresh = 0;
    int recent = 0;
    if (!p->ready) prediction_errors(p, indices, errors);
    if (p->cross)
        for (int64_t t = 0; t < p->span; t++) errors[t] -= p->cross[t];
    if (!p->repeats) return p->span;
    note(e, SECTION);
    for (int64_t t = 0; t < p->span; t++) {
        int same = t && indices[t] == indices[t - 1];
        if (t) {
            note(e, REPEAT_CODES + 2 * recent + same);
            counts[2 * recent + same]++;
            recent = 2 * same + (recent >> 1);
        }
        if (!same) errors[fresh++] = errors[t];
    }
    return fresh;
}

/* Sections that take more bits a number than this are not tried by bits: those take longer to decode.
   Many numbers whose mean is below a half are coded by bits, and nothing else is tried. */
enum { QUIET = 2 * 256, SURE = 1024 };

/* Whether numbers are so quiet and many that a class would be larger. */
static int surely_quiet(const int64_t *numbers, int64_t count)
{
    int64_t left = count < SURE ? 0 : 2 * count / 3;
    for (int64_t i = 0; i < count && left > 0; i++) {
        int64_t u = numbers[i] < 0 ? -numbers[i] : numbers[i];
        left = u < left ? left - u : 0;
    }
    return left > 0;
}

static int encode(workshop *w, const plan *p, const int64_t *indices, uint8_t *out, int64_t size,
                  int64_t *written)
{
    enum { HEAD = 2 + REPEAT_CONTEXTS + SIGN_CONTEXTS };
    encoder e, before;
    histogram seen;
    share shares[BITS + 2 * (REPEAT_CONTEXTS + SIGN_CONTEXTS)];
    int64_t repeats[2 * REPEAT_CONTEXTS] = {0}, signs[2 * SIGN_CONTEXTS], cost, more, other;
    int head = 0, by_bits = 0, class = 0, later = 0, first = 0, status;
    uint8_t start[HEAD];
    *written = 0;
    if (!within(indices, p->span, p->limit)) return BAD_INDEX;
    int64_t room = size < HEAD ? 0 : size - HEAD;
    encoder_init(&e, w->codes, out + HEAD, room);
    memset(&seen, 0, sizeof seen);
    int64_t fresh = errors_and_repeats(&e, p, indices, w->errors, repeats), *errors = w->errors;
    before = e;
    cost = INT64_MAX;
    if (!surely_quiet(errors, fresh)) {
        later = signs_pay(errors, fresh, signs, &more);
        first = start_of(errors, fresh);
        status = later ? put_integers(&e, errors, fresh, first, UNSIGNED, 0, &seen)
                       : put_integers(&e, errors, fresh, first, RAW_SIGNS, 0, &seen);
        if (status) return status;
        class = best_class(&seen, &cost);
        cost += 2048 + 256 * (raw_bits(&e) - raw_bits(&before)) + (later ? more : 0);
    }
    if (cost == INT64_MAX || cost <= QUIET * fresh) {
        int64_t noted = e.noted;
        if (!note_by_bits(&e, w, errors, fresh, RAW_SIGNS, &other)) return NO_MEMORY;
        by_bits = other < cost;
        if (by_bits) {
            int64_t flags = e.noted - noted;
            memmove(e.codes + before.noted, e.codes + noted, 2 * (size_t)flags);
            before.codes = e.codes;
            before.noted += flags;
            e = before;
            put_raw_by_bits(&e, errors, fresh);
        } else
            e.noted = noted;
    }
    later = later && !by_bits;
    if (later) note_signs(&e, errors, fresh, SIGN_CODES);
    int many = !by_bits && e.noted >= MANY;
    memcpy(shares, hapfmt_classes[class].shares, sizeof hapfmt_classes[class].shares);
    start[head++] = (uint8_t)(by_bits ? BY_BITS : class | 16 * many | 32 * later);
    if (!by_bits) start[head++] = (uint8_t)first;
    if (p->repeats) head += put_bits(shares + REPEAT_CODES, start + head, repeats, REPEAT_CONTEXTS);
    if (later) head += put_bits(shares + SIGN_CODES, start + head, signs, SIGN_CONTEXTS);
    int64_t coded = by_bits ? encoder_finish_flags(&e, shares, w->words)
                            : encoder_finish(&e, shares, many ? 4 : 1, w->words);
    *written = head + coded;
    if (coded > room) { *written = coded + HEAD; return NO_ROOM; }
    memmove(out + head, out + HEAD, (size_t)coded);
    memcpy(out, start, (size_t)head);
    return DONE;
}

#endif
