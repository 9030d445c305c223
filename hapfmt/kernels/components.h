/* Packets of LPCR: their component packets to counts (SPEC 9.1 and 9.5). The readable twin is
   decode_components in hapfmt/codecs/predicted.py, which says what is wrong where anything is. */
#ifndef HAPFMT_COMPONENTS_H
#define HAPFMT_COMPONENTS_H

#include "bytes.h"
#include "lpcr.h"

enum { COMPONENTS_MOST = 255, REFERENCES_MOST = 8, REFERENCE_SIZE = 4, WEIGHT_SHIFT = 6 };
enum { REPEATS = 8, CONSTANT = 16, REFERENCES = 64, UNUSED = 160 };
enum { BROKEN = 0, WITHIN = 1, CLAMPED = 2 };

/* Which count each index stands for; ``levels`` [limit + 1] of a deadband's grid, or NULL. */
typedef struct {
    const int64_t *levels;
    int64_t limit, step, zero, low, high;
} scale;

typedef struct {
    const uint8_t *references;
    int difference, order, repeats, constant, count;
    int8_t reflections[ORDERS];
    int64_t base;
    bytes coded;
} component;

/* The header of the component at ``place``; 0 where it breaks a rule. */
static int take_component(bytes b, int place, int64_t limit, component *c)
{
    if (b.size < 2 || b.size < 2 + b.at[1]) return 0;
    int flags = b.at[0], order = b.at[1];
    c->difference = flags & 7;
    c->order = order;
    c->repeats = flags & REPEATS ? 1 : 0;
    c->constant = flags & CONSTANT ? 1 : 0;
    c->count = 0;
    if (order > ORDERS || c->difference > (order ? 1 : DIFFERENCES) || flags & UNUSED ||
        (c->constant && (order || flags != CONSTANT)))
        return 0;
    for (int i = 0; i < order; i++) {
        c->reflections[i] = (int8_t)(b.at[2 + i] < 128 ? b.at[2 + i] : b.at[2 + i] - 256);
        if (c->reflections[i] == -128) return 0;
    }
    b.at += 2 + order;
    b.size -= 2 + order;
    if (flags & REFERENCES) {
        int count = b.size ? b.at[0] : 0;
        if (count < 1 || count > REFERENCES_MOST || b.size < 1 + REFERENCE_SIZE * count) return 0;
        c->references = b.at + 1;
        c->count = count;
        for (int i = 0; i < count; i++) {
            int after = i + 1 < count ? c->references[REFERENCE_SIZE * (i + 1)] : place;
            if (c->references[REFERENCE_SIZE * i] >= after) return 0;
        }
        b.at += 1 + REFERENCE_SIZE * count;
        b.size -= 1 + REFERENCE_SIZE * count;
    }
    int64_t base = take_varint(&b);
    if (b.size < 0) return 0;
    c->base = (base >> 1) ^ -(base & 1);
    c->coded = b;
    return c->base >= -limit && c->base <= limit && !(c->constant && b.size);
}

/* The components of a packet, and which of them others refer to; 0 where one breaks a rule. */
static int take_components(bytes packet, int count, int64_t limit, component *found, uint8_t *referred)
{
    int64_t sizes[COMPONENTS_MOST], sum = 0;
    for (int i = 0; i + 1 < count; i++) {
        sizes[i] = take_varint(&packet);
        sum += sizes[i];
    }
    if (packet.size < sum) return 0;
    memset(referred, 0, (size_t)count);
    for (int i = 0; i < count; i++) {
        bytes part = {packet.at, i + 1 < count ? sizes[i] : packet.size};
        packet.at += part.size;
        packet.size -= part.size;
        if (!take_component(part, i, limit, found + i)) return 0;
        for (int k = 0; k < found[i].count; k++) referred[found[i].references[REFERENCE_SIZE * k]] = 1;
    }
    return 1;
}

/* x of SPEC 9.5; ``rows`` [components][span], ``d`` and ``cross`` [span]. */
static int cross_terms(const plan *p, const component *c, int64_t *const *rows, int64_t *d, int64_t *cross)
{
    int64_t span = p->span;
    for (int64_t t = 0; t < span; t++) cross[t] = 1 << (WEIGHT_SHIFT - 1);
    for (int k = 0; k < c->count; k++) {
        const uint8_t *r = c->references + REFERENCE_SIZE * k;
        const int64_t *row = rows[r[0]];
        plan other = *p;
        int w[3];
        for (int i = 0; i < 3; i++) w[i] = r[1 + i] < 128 ? r[1 + i] : r[1 + i] - 256;
        other.base = row[0];
        prediction_errors(&other, row, d);
        for (int64_t t = 0; t < span; t++) cross[t] += w[1] * d[t];
        for (int64_t t = 1; t < span; t++) cross[t] += w[0] * d[t - 1];
        for (int64_t t = 0; t + 1 < span; t++) cross[t] += w[2] * d[t + 1];
    }
    for (int64_t t = 0; t < span; t++) cross[t] >>= WEIGHT_SHIFT;
    return within(cross, span, CROSS_LIMIT);
}

/* Counts within the range; whether any had to be moved into it. */
static int to_counts(const scale *s, const int64_t *indices, int64_t span, int32_t *out)
{
    enum { PART = 256 };
    int moved = 0;
    for (int64_t from = 0; from < span; from += PART) {
        int64_t counts[PART];
        uint64_t beyond = 0, low = (uint64_t)s->low, high = (uint64_t)s->high;
        int count = span - from < PART ? (int)(span - from) : PART;
        const int64_t *in = indices + from;
        if (s->levels)
            for (int i = 0; i < count; i++)
                counts[i] = s->zero + (in[i] < 0 ? -s->levels[-in[i]] : s->levels[in[i]]);
        else if (s->step == 1)
            for (int i = 0; i < count; i++) counts[i] = in[i] + s->zero;
        else
            for (int i = 0; i < count; i++) counts[i] = in[i] * s->step + s->zero;
        for (int i = 0; i < count; i++) beyond |= ((uint64_t)counts[i] - low) | (high - (uint64_t)counts[i]);
        if (beyond >> 63) {
            moved = 1;
            for (int i = 0; i < count; i++)
                counts[i] = counts[i] < s->low ? s->low : counts[i] > s->high ? s->high : counts[i];
        }
        for (int i = 0; i < count; i++) out[from + i] = (int32_t)counts[i];
    }
    return moved;
}

/* Where a packet is decoded. */
typedef struct {
    component *components;
    uint8_t *copy, *same;
    int64_t *memory, *rows[COMPONENTS_MOST];
} bench;

static void bench_close(bench *b)
{
    free(b->components);
    free(b->copy);
    free(b->same);
    free(b->memory);
}

/* Memory for what the components of a packet need; 0 where it ran out. */
static int bench_room(bench *b, int count, const uint8_t *referred, int64_t span)
{
    int64_t rows = 1, most = 0;
    int repeats = 0, references = 0;
    for (int i = 0; i < count; i++) {
        rows += referred[i];
        repeats |= b->components[i].repeats;
        references |= b->components[i].count > 0;
        if (b->components[i].coded.size > most) most = b->components[i].coded.size;
    }
    rows += 2 * references;
    b->copy = malloc((size_t)(most + 2 * MARGIN));
    b->memory = malloc((size_t)(rows * span) * sizeof *b->memory);
    if (repeats) b->same = malloc((size_t)span);
    if (!b->copy || !b->memory || (repeats && !b->same)) return 0;
    /* The first row is for components that none refers to, the last two for what references say. */
    int64_t *next = b->memory + span;
    for (int i = 0; i < count; i++) {
        b->rows[i] = referred[i] ? next : b->memory;
        if (referred[i]) next += span;
    }
    return 1;
}

static int decode_component(bench *b, const component *c, int64_t *row, int64_t limit, int64_t span,
                            const int32_t *sines, int64_t *last_two)
{
    int32_t coefficients[ORDERS];
    if (c->constant) {
        for (int64_t t = 0; t < span; t++) row[t] = c->base;
        return 1;
    }
    if (!step_up(c->reflections, c->order, sines, coefficients)) return 0;
    plan p = {.difference = c->difference, .order = c->order, .repeats = c->repeats, .base = c->base,
              .limit = limit, .span = span, .coefficients = coefficients};
    if (c->count) {
        if (!cross_terms(&p, c, b->rows, last_two, last_two + span)) return 0;
        p.cross = last_two + span;
    }
    int64_t size = c->coded.size, taken;
    memset(b->copy, 0, MARGIN);
    memcpy(b->copy + MARGIN, c->coded.at, (size_t)size);
    memset(b->copy + MARGIN + size, 0, MARGIN);
    return decode(b->copy + MARGIN, size, &p, b->same, row, &taken) == DONE;
}

/* ``out`` [count][span]; BROKEN where the packet breaks a rule, -1 where memory ran out. */
static int decode_packet(bytes packet, int count, int64_t span, const scale *s, const int32_t *sines,
                         int32_t *out)
{
    uint8_t referred[COMPONENTS_MOST];
    int result = WITHIN;
    bench b = {0};
    b.components = malloc((size_t)count * sizeof *b.components);
    if (!b.components) return -1;
    if (!take_components(packet, count, s->limit, b.components, referred)) result = BROKEN;
    else if (!bench_room(&b, count, referred, span)) result = -1;
    int64_t *last_two = b.memory + span;
    for (int i = 0; result > 0 && i < count; i++) last_two += referred[i] ? span : 0;
    for (int i = 0; result > 0 && i < count; i++) {
        int64_t *row = b.rows[i];
        if (!decode_component(&b, b.components + i, row, s->limit, span, sines, last_two)) result = BROKEN;
        else if (to_counts(s, row, span, out + i * span)) result = CLAMPED;
    }
    bench_close(&b);
    return result;
}

#endif
