/* The hot loops of LPCX (SPEC 9.7); the readable twin is hapfmt/codecs/exact.py.

   The input is hostile: every id is checked to be below the number of ids. At most as many nodes are
   remembered as there are samples. */
#include "kernels.h"

#include <float.h>

#include "bytes.h"
#include "coded.h"

#if defined(__GNUC__)
/* Not every function of the headers is used here. */
#pragma GCC diagnostic ignored "-Wunused-function"
#endif

enum { REMEMBERED = 32, RECALL = 1, FOUR = 2 };
enum { FRESH = 0, SAME = 1, KNOWN = 2, RECALLS = 3, RANKS = 6, LENGTH_CODES = 2 * RECALLS * RANKS };

/* The corrections of each count, in lists. */
typedef struct {
    int64_t *values;
    int32_t nodes, *links, *heads; /* links and heads: one more than a node, 0 for none */
} memory;

static void memory_init(memory *m, int64_t *work, int64_t span)
{
    m->nodes = 0;
    m->values = work;
    m->links = (int32_t *)(work + span);
    m->heads = m->links + span;
}

/* A new correction becomes the first of its count; the last of 32 makes room. */
static inline void remember(memory *m, int32_t id, int64_t correction)
{
    int32_t *link = &m->heads[id], node;
    int known = 0;
    while (*link && known < REMEMBERED - 1) {
        link = &m->links[*link - 1];
        known++;
    }
    if (*link) {
        node = *link;
        *link = 0;
    } else
        node = ++m->nodes;
    m->values[node - 1] = correction;
    m->links[node - 1] = m->heads[id];
    m->heads[id] = node;
}

static inline void to_front(memory *m, int32_t id, int32_t *link)
{
    int32_t node = *link;
    *link = m->links[node - 1];
    m->links[node - 1] = m->heads[id];
    m->heads[id] = node;
}

/* ---- decoding ---- */

typedef struct {
    int recall, lanes;
    uint8_t p[RECALLS][REMEMBERED];
    length_table lengths;
} heading;

/* Bytes of the heading before the coded bytes; 0 if the heading is not defined. */
static int64_t take_heading(const uint8_t *in, int64_t size, heading *h)
{
    int64_t at = 2;
    if (size < 2) return 0;
    h->recall = in[0] & RECALL;
    h->lanes = in[0] & FOUR ? 4 : 1;
    for (int x = 0; h->recall && x < RECALLS; x++) {
        int count = at < size ? in[at++] : 0xFF;
        if (count > REMEMBERED || at + count > size) return 0;
        for (int i = 0; i < REMEMBERED; i++)
            h->p[x][i] = count ? in[at + (i < count ? i : count - 1)] : 128;
        for (int i = 0; i < count; i++)
            if (!in[at + i]) return 0;
        at += count;
    }
    int64_t taken = take_lengths(in + at, size - at, &h->lengths);
    return taken ? at + taken : 0;
}

/* ``ranks`` [span]: the place on the list of its count, -1 where a correction is coded in full;
   ``known`` [span] of zeros: how long the lists are. */
static int get_ranks(decoder *d, const heading *h, const int32_t *ids, int64_t span, int8_t *ranks,
                     uint8_t *known)
{
    int lane = 0;
    int32_t last = -1;
    for (int64_t t = 0; t < span; t++) {
        int32_t id = ids[t];
        int x = !known[id] ? FRESH : id == last ? SAME : KNOWN, count = known[id] ? known[id] : 1;
        ranks[t] = -1;
        for (int i = 0; i < count && ranks[t] < 0; i++) {
            if (get_bit(d, lane, h->p[x][i])) ranks[t] = (int8_t)i;
            lane = (lane + 1) & (d->lanes - 1);
            if (overrun(d)) return BAD_END;
        }
        if (x == FRESH) known[id] = 1;
        else if (ranks[t] < 0 && known[id] < REMEMBERED) known[id]++;
        last = id;
    }
    return DONE;
}

static int decode_corrections(uint8_t *in, int64_t size, const int32_t *ids, int64_t *out,
                              int64_t span, int64_t *work, int64_t *taken)
{
    heading h;
    decoder d;
    memory m;
    int64_t head = take_heading(in, size, &h);
    int lane = 0;
    *taken = 0;
    if (!head) return BAD_CODING;
    int8_t *ranks = calloc((size_t)span + 1, 2);
    if (!ranks) return NO_MEMORY;
    decoder_init(&d, in, head, size, h.lanes);
    int status = overrun(&d) ? BAD_END : DONE;
    if (ids && !status) status = get_ranks(&d, &h, ids, span, ranks, (uint8_t *)ranks + span);
    memory_init(&m, work, ids ? span : 0);
    for (int64_t t = 0; t < span && !status; t++) {
        int rank = ids ? ranks[t] : -1;
        if (rank >= 0 && !m.heads[ids[t]]) {
            out[t] = 0;
            remember(&m, ids[t], 0);
        } else if (rank >= 0) {
            int32_t *link = &m.heads[ids[t]];
            while (rank-- > 0) link = &m.links[*link - 1];
            out[t] = m.values[*link - 1];
            to_front(&m, ids[t], link);
        } else {
            status = get_length(&d, &h.lengths, lane, out + t);
            lane = (lane + 1) & (d.lanes - 1);
            if (ids) remember(&m, ids[t], out[t]);
        }
    }
    free(ranks);
    if (!status) status = check_end(&d);
    *taken = head + front_taken(&d);
    return status;
}

/* ---- rules ---- */

/* Products and sums are rounded one by one, in their order: this file is compiled without fused or wider
   arithmetic. */
enum { LINEAR_BLOCK = 256, TERMS_MOST = 16, TERM_SIZE = 10, COMPONENTS_MOST = 255 };
enum { QUOTIENT = 0, PRODUCT = 1, DIGITS = 2, CUBIC = 3, LINEAR = 4 };

typedef struct {
    int rule, terms, component[TERMS_MOST], lag[TERMS_MOST];
    double coefficients[4], weights[TERMS_MOST];
    int64_t affine[3];
} exact_rule;

static int within_53(int64_t v) { return v >= -((int64_t)1 << 53) && v <= (int64_t)1 << 53; }

static double take_double(const uint8_t *in)
{
    uint64_t bits = 0;
    double v;
    for (int i = 7; i >= 0; i--) bits = bits << 8 | in[i];
    memcpy(&v, &bits, sizeof v);
    return v;
}

/* The rules of all components; 0 where terms refer to what is not known, or anything is not as Python's
   parser leaves it. */
static int take_rules(const uint8_t *in, int64_t size, int count, exact_rule *rules)
{
    uint8_t known[COMPONENTS_MOST] = {0};
    for (int i = 0; i < count; i++) {
        exact_rule *r = rules + i;
        if (size < 4) return 0;
        r->rule = in[0];
        r->terms = in[2];
        int numbers = r->rule == CUBIC ? 4 : r->rule == LINEAR;
        if (r->rule > LINEAR || r->terms > TERMS_MOST || (r->rule == LINEAR) != (r->terms > 0) ||
            size < 4 + 8 * numbers + TERM_SIZE * r->terms)
            return 0;
        in += 4;
        for (int k = 0; k < numbers; k++, in += 8) r->coefficients[k] = take_double(in);
        for (int k = 0; k < r->terms; k++, in += TERM_SIZE) {
            r->component[k] = in[0];
            r->lag[k] = in[1];
            r->weights[k] = take_double(in + 2);
        }
        size -= 4 + 8 * numbers + TERM_SIZE * r->terms;
        known[i] = r->rule != LINEAR;
    }
    for (int i = 0; i < count; i++) {
        for (int k = 0; k < rules[i].terms; k++) {
            int a = rules[i].component[k];
            if (a >= count || (!known[a] && (a != i || !rules[i].lag[k]))) return 0;
        }
        known[i] = 1;
    }
    return size == 0;
}

static int64_t place_of(double v)
{
    int64_t bits;
    memcpy(&bits, &v, sizeof bits);
    return bits < 0 ? ~(bits & INT64_MAX) : bits;
}

static double double_at(uint64_t place)
{
    uint64_t bits = place >> 63 ? ~place | (uint64_t)1 << 63 : place;
    double v;
    memcpy(&v, &bits, sizeof v);
    return v;
}

INLINE double quotient_of(const int64_t *affine, int32_t count)
{
    return (double)(int64_t)((uint64_t)count * (uint64_t)affine[0] + (uint64_t)affine[1]) / (double)affine[2];
}

/* ``out`` [span], which terms may look back into; ``all``: the exact values of all components. */
static void put_linear(const exact_rule *r, int own, const int32_t *counts, int64_t span, const double *all,
                       const int64_t *moves, double *out)
{
    int64_t reach = 0;
    int early = 0; /* how many of the first terms do not look back into this component */
    for (int k = 0; k < r->terms; k++)
        if (r->lag[k] > reach) reach = r->lag[k];
    while (early < r->terms && r->component[early] != own) early++;
    const double *later[TERMS_MOST];
    double weights[TERMS_MOST];
    int rest = r->terms - early;
    for (int k = 0; k < rest; k++) {
        later[k] = all + r->component[early + k] * span - r->lag[early + k];
        weights[k] = r->weights[early + k];
    }
    for (int64_t from = 0; from < span; from += LINEAR_BLOCK) {
        int64_t stop = span - from < LINEAR_BLOCK ? span : from + LINEAR_BLOCK;
        int64_t begin = reach < from ? from : reach > stop ? stop : reach;
        double sums[LINEAR_BLOCK];
        for (int64_t t = from; t < begin; t++) sums[t - from] = quotient_of(r->affine, counts[t]);
        for (int64_t t = begin; t < stop; t++) sums[t - from] = r->coefficients[0];
        for (int k = 0; k < early; k++) {
            const double *x = all + r->component[k] * span + begin - r->lag[k], weight = r->weights[k];
            double *sum = sums + (begin - from);
            for (int64_t t = 0; t < stop - begin; t++) sum[t] += weight * x[t];
        }
        for (int64_t t = from; t < stop; t++) {
            double v = sums[t - from];
            if (t >= begin)
                for (int k = 0; k < rest; k++) v += weights[k] * later[k][t];
            v = v - v == 0 ? v + 0.0 : quotient_of(r->affine, counts[t]);
            out[t] = moves[t] ? double_at((uint64_t)place_of(v) + (uint64_t)moves[t]) : v;
        }
    }
}

static void put_values(const exact_rule *r, const int32_t *counts, int64_t span, const int64_t *moves,
                       double *out)
{
    double step = (double)r->affine[0] / (double)r->affine[2], zero = (double)r->affine[1] / (double)r->affine[2];
    const double *c = r->coefficients;
    if (r->rule == QUOTIENT)
        for (int64_t t = 0; t < span; t++) out[t] = quotient_of(r->affine, counts[t]);
    else if (r->rule == PRODUCT)
        for (int64_t t = 0; t < span; t++) out[t] = counts[t] * step + zero;
    else if (r->rule == CUBIC)
        for (int64_t t = 0; t < span; t++) {
            double x = counts[t];
            out[t] = (((c[3] * x + c[2]) * x + c[1]) * x + c[0]) + 0.0;
        }
    for (int64_t t = 0; t < span; t++)
        if (moves[t]) out[t] = double_at((uint64_t)place_of(out[t]) + (uint64_t)moves[t]);
}

/* Where a part is decoded. ``slots``: a hash table, the first sample of each count. */
typedef struct {
    int64_t *moves, *work;
    int32_t *ids, *slots;
    int bits;
} exact_bench;

/* Samples of one count have one id. */
static void number_counts(const int32_t *counts, int64_t span, exact_bench *b)
{
    uint32_t mask = ((uint32_t)1 << b->bits) - 1;
    int32_t next = 0;
    memset(b->slots, 0xFF, ((size_t)1 << b->bits) * sizeof *b->slots);
    for (int64_t t = 0; t < span; t++) {
        uint32_t at = ((uint32_t)counts[t] * 2654435769u) >> (32 - b->bits);
        while (b->slots[at] >= 0 && counts[b->slots[at]] != counts[t]) at = (at + 1) & mask;
        if (b->slots[at] < 0) {
            b->slots[at] = (int32_t)t;
            b->ids[t] = next++;
        } else
            b->ids[t] = b->ids[b->slots[at]];
    }
}

/* Corrections of a component, from its part of the packet. */
static int decode_part(const uint8_t *part, int64_t size, const int32_t *counts, int64_t span, exact_bench *b)
{
    if (!size) {
        memset(b->moves, 0, (size_t)span * sizeof *b->moves);
        return DONE;
    }
    if (size < 2 || part[0] & ~(RECALL | FOUR) || part[1] >= LENGTHS) return BAD_CODING;
    int recall = part[0] & RECALL, shift = part[1];
    int64_t taken;
    if (recall) {
        number_counts(counts, span, b);
        memset(b->work, 0, (size_t)(2 * span) * sizeof *b->work);
    }
    uint8_t *copy = with_margins(part, size);
    if (!copy) return NO_MEMORY;
    int status = decode_corrections(copy + MARGIN, size, recall ? b->ids : NULL, b->moves, span, b->work, &taken);
    free(copy);
    for (int64_t t = 0; t < span; t++) b->moves[t] = (int64_t)((uint64_t)b->moves[t] << shift);
    return status;
}

static int decode_values(const uint8_t *rest, int64_t size, const exact_rule *rules, int count,
                         const int32_t *counts, int64_t span, double *values)
{
    const uint8_t *parts[COMPONENTS_MOST];
    int64_t sizes[COMPONENTS_MOST] = {0}, sum = 0;
    int status = DONE;
    bytes b = {rest, size};
    if (size) {
        for (int i = 0; i + 1 < count; i++) {
            sizes[i] = take_varint(&b);
            sum += sizes[i];
        }
        if (b.size < sum) return BAD_CODING;
        sizes[count - 1] = b.size - sum;
        for (int i = 0; i < count; i++) {
            parts[i] = b.at;
            b.at += sizes[i];
        }
    }
    exact_bench bench = {NULL, NULL, NULL, NULL, 4};
    while (bench.bits < 31 && (int64_t)1 << bench.bits < 2 * span) bench.bits++;
    bench.moves = malloc((size_t)(3 * span) * sizeof *bench.moves);
    bench.ids = malloc((size_t)span * sizeof *bench.ids + ((size_t)1 << bench.bits) * sizeof *bench.slots);
    if (!bench.moves || !bench.ids) status = NO_MEMORY;
    bench.work = bench.moves + span;
    bench.slots = bench.ids + span;
    for (int late = 0; late < 2; late++)
        for (int i = 0; !status && i < count; i++) {
            if ((rules[i].rule == LINEAR) != late) continue;
            const int32_t *row = counts + i * span;
            status = decode_part(size ? parts[i] : rest, sizes[i], row, span, &bench);
            if (status) break;
            if (late) put_linear(rules + i, i, row, span, values, bench.moves, values + i * span);
            else put_values(rules + i, row, span, bench.moves, values + i * span);
        }
    free(bench.moves);
    free(bench.ids);
    return status;
}

/* ---- encoding ---- */

static int rank_code(int x, int i, int bit) { return 2 * (RANKS * x + (i < RANKS ? i : RANKS - 1)) + bit; }

/* Notes the bits of all ranks. ``full``: the corrections that are on no list; how many. */
static int64_t note_ranks(encoder *e, memory *m, const int32_t *ids, const int64_t *in, int64_t span,
                          int64_t *full, int64_t *counts)
{
    int32_t last = -1;
    int64_t count = 0;
    note(e, SECTION);
    for (int64_t t = 0; t < span; t++) {
        int32_t id = ids[t], *link = &m->heads[id];
        int x = !*link ? FRESH : id == last ? SAME : KNOWN, found = 0;
        for (int i = 0; !found && (*link || (x == FRESH && !i)); i++) {
            found = x == FRESH ? !in[t] : m->values[*link - 1] == in[t];
            int code = rank_code(x, i, found);
            note(e, code);
            counts[code]++;
            if (!found && x != FRESH) link = &m->links[*link - 1];
        }
        if (found && x != FRESH) to_front(m, id, link);
        else remember(m, id, in[t]);
        if (!found) full[count++] = in[t];
        last = id;
    }
    return count;
}

static int64_t put_recall(uint8_t *out, share *shares, const int64_t *counts)
{
    int64_t at = 0;
    for (int x = 0; x < RECALLS; x++) {
        const int64_t *these = counts + rank_code(x, 0, 0);
        int used = 0;
        for (int i = 0; i < RANKS; i++)
            if (these[2 * i] + these[2 * i + 1]) used = i + 1;
        out[at++] = (uint8_t)used;
        at += put_bits(shares + rank_code(x, 0, 0), out + at, these, used);
    }
    return at;
}

static int encode_corrections(uint8_t *out, int64_t size, const int32_t *ids, const int64_t *in,
                              int64_t span, int shift, int64_t *work, int64_t *written)
{
    enum { HEAD = 2 + RECALLS * (1 + RANKS) + 2 + LENGTHS };
    memory m;
    encoder e;
    int64_t counts[LENGTH_CODES + LENGTHS] = {0}, full = span, head = 2, room = size - HEAD;
    share shares[LENGTH_CODES + LENGTHS];
    uint8_t start[HEAD];
    *written = size + HEAD;
    if (room < 0) return NO_ROOM;
    for (int64_t t = 0; t < span; t++)
        if (in[t] == INT64_MIN) return BAD_ERROR;
    /* A rank takes up to 32 bits. */
    int64_t most = ids ? 34 * span + 8 : span + 8;
    uint16_t *codes = malloc((size_t)(2 * most));
    int64_t *rest = malloc((size_t)(8 * span + 8));
    uint16_t *words = NULL;
    int status = codes && rest ? DONE : NO_MEMORY;
    if (!status) {
        encoder_init(&e, codes, out + HEAD, room);
        memory_init(&m, work, ids ? span : 0);
        if (ids) full = note_ranks(&e, &m, ids, in, span, rest, counts);
        else memcpy(rest, in, (size_t)(8 * span));
        note(&e, SECTION);
        for (int64_t i = 0; i < full; i++) {
            int length = bit_length((uint64_t)(rest[i] < 0 ? -rest[i] : rest[i]));
            counts[LENGTH_CODES + length]++;
            put_length(&e, rest[i], LENGTH_CODES);
        }
        words = malloc((size_t)(2 * (e.noted + 8)));
        if (!words) status = NO_MEMORY;
    }
    if (!status) {
        int four = e.noted >= MANY;
        start[0] = (uint8_t)((ids ? RECALL : 0) | FOUR * four);
        start[1] = (uint8_t)shift;
        if (ids) head += put_recall(start + head, shares, counts);
        head += put_lengths(start + head, shares + LENGTH_CODES, counts + LENGTH_CODES);
        int64_t coded = encoder_finish(&e, shares, four ? 4 : 1, words);
        *written = coded > room ? coded + HEAD : head + coded;
        if (coded > room) status = NO_ROOM;
        else {
            memmove(out + head, out + HEAD, (size_t)coded);
            memcpy(out, start, (size_t)head);
        }
    }
    free(codes);
    free(rest);
    free(words);
    return status;
}

static int fits(const Py_buffer *ids, const Py_buffer *corrections, const Py_buffer *work)
{
    int64_t span = corrections->len / 8;
    int right = whole(ids, 4) && whole(corrections, 8) && whole(work, 8);
    if (!ids->len) return right;
    right = right && ids->len == 4 * span && work->len == 16 * span && span <= INT32_MAX;
    const int32_t *names = ids->buf;
    for (int64_t t = 0; right && t < span; t++) right = names[t] >= 0 && names[t] < span;
    return right;
}

/* (exact values of a packet, ids int32 or none, corrections int64, work int64 of zeros, shift)
   -> (status, bytes read or written) */
static PyObject *run_corrections(PyObject *args, int decoding)
{
    Py_buffer coded, ids, corrections, work;
    int shift, status = NO_ROOM;
    if (!PyArg_ParseTuple(args, decoding ? "y*y*w*w*i" : "w*y*y*w*i", &coded, &ids, &corrections,
                          &work, &shift))
        return NULL;
    PyObject *result = NULL;
    int64_t span = corrections.len / 8, size = 0;
    if (shift < 0 || shift >= LENGTHS || !fits(&ids, &corrections, &work))
        PyErr_SetString(PyExc_ValueError, "not arrays of corrections");
    else {
        const int32_t *names = ids.len ? ids.buf : NULL;
        Py_BEGIN_ALLOW_THREADS
        if (decoding) {
            uint8_t *copy = with_margins(coded.buf, coded.len);
            status = !copy ? NO_MEMORY : decode_corrections(copy + MARGIN, coded.len, names,
                                                            corrections.buf, span, work.buf, &size);
            free(copy);
        } else
            status = encode_corrections(coded.buf, coded.len, names, corrections.buf, span, shift,
                                        work.buf, &size);
        Py_END_ALLOW_THREADS
        result = status == NO_MEMORY ? PyErr_NoMemory() : Py_BuildValue("iL", status, (long long)size);
    }
    PyBuffer_Release(&coded);
    PyBuffer_Release(&ids);
    PyBuffer_Release(&corrections);
    PyBuffer_Release(&work);
    return result;
}

static PyObject *exact_decode(PyObject *self, PyObject *args)
{
    (void)self;
    return run_corrections(args, 1);
}

static PyObject *exact_encode(PyObject *self, PyObject *args)
{
    (void)self;
    return run_corrections(args, 0);
}

/* (exact values of a packet, parameters of LPCX, calibrations int64 [components, 3], counts int32
   [components, ticks], values float64 [components, ticks]) -> whether all rules are kept. The values are
   filled; before, those of rule 2 are what the rule gives. */
static PyObject *exact_packet(PyObject *self, PyObject *args)
{
    (void)self;
    Py_buffer rest, parameters, affines, counts, values;
    if (!PyArg_ParseTuple(args, "y*y*y*y*w*", &rest, &parameters, &affines, &counts, &values)) return NULL;
    PyObject *result = NULL;
    exact_rule rules[COMPONENTS_MOST];
    Py_ssize_t count = affines.len / 24, span = count ? counts.len / 4 / count : 0;
    int right = count >= 1 && count <= COMPONENTS_MOST && whole(&affines, 8) && affines.len == 24 * count &&
                whole(&counts, 4) && span >= 1 && counts.len == 4 * count * span && span <= INT32_MAX &&
                whole(&values, 8) && values.len == 2 * counts.len &&
                take_rules(parameters.buf, parameters.len, (int)count, rules);
    const int64_t *affine = affines.buf;
    for (Py_ssize_t i = 0; right && i < count; i++) {
        memcpy(rules[i].affine, affine + 3 * i, sizeof rules[i].affine);
        right = within_53(rules[i].affine[0]) && within_53(rules[i].affine[1]) && rules[i].affine[2] >= 1 &&
                within_53(rules[i].affine[2]);
    }
    if (!right) PyErr_SetString(PyExc_ValueError, "not the parameters of exact values, or not their arrays");
    else {
        int status = BAD_CODING;
#if FLT_EVAL_METHOD == 0
        Py_BEGIN_ALLOW_THREADS
        status = decode_values(rest.buf, rest.len, rules, (int)count, counts.buf, span, values.buf);
        Py_END_ALLOW_THREADS
#endif
        result = status == NO_MEMORY ? PyErr_NoMemory() : PyBool_FromLong(status == DONE);
    }
    PyBuffer_Release(&rest);
    PyBuffer_Release(&parameters);
    PyBuffer_Release(&affines);
    PyBuffer_Release(&counts);
    PyBuffer_Release(&values);
    return result;
}

PyMethodDef hapfmt_exact_methods[] = {
    {"exact_packet", exact_packet, METH_VARARGS, NULL},
    {"exact_decode", exact_decode, METH_VARARGS, NULL},
    {"exact_encode", exact_encode, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL},
};
