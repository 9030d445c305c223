/* A packet of LPCR by one call: predictor and coded bytes. The readable twin is
   hapfmt/encoder/predict.py. */
#include "kernels.h"

#if defined(__GNUC__)
/* Not every function of the headers is used here. */
#pragma GCC diagnostic ignored "-Wunused-function"
#endif

#include "choice.h"

enum { HEADER = 2 + ORDERS + 10, CONSTANT = 16, REPEATS = 8 };

/* 256 times the bits of a sample: where it is below, what codes by bits may know of repeats anyway. */
enum { SPARSE = 384 };

static int64_t put_header(uint8_t *out, int flags, const way *w, int64_t base)
{
    int64_t size = 0;
    out[size++] = (uint8_t)flags;
    out[size++] = (uint8_t)w->order;
    for (int j = 0; j < w->order; j++) out[size++] = (uint8_t)w->reflections[j];
    uint64_t u = (uint64_t)base << 1 ^ (uint64_t)(base >> 63);
    for (; u >> 7; u >>= 7) out[size++] = (uint8_t)(u | 128);
    out[size++] = (uint8_t)u;
    return size;
}

typedef struct {
    uint8_t *bytes;
    int64_t room, size;
    int coding; /* the byte that says how it is coded */
} packet;

static int put_packet(const search *s, const way *w, workshop *shop, packet *out)
{
    plan p = {0};
    p.difference = w->difference;
    p.order = w->order;
    p.repeats = w->repeats;
    p.base = w->difference ? s->first : s->mean;
    p.limit = INDEX_LIMIT;
    p.span = s->count;
    p.coefficients = w->coefficients;
    p.ready = exact_errors(s, w, shop->errors);
    int64_t head = put_header(out->bytes, w->difference | REPEATS * w->repeats, w, p.base);
    int status = encode(shop, &p, s->indices, out->bytes + head, out->room - head, &out->size);
    out->coding = out->bytes[head];
    out->size += head;
    return status;
}

/* Half of ``sum`` twice over ``count``, rounded to nearest. */
static int64_t mean_of(const int64_t *indices, int64_t count)
{
    int64_t sum = 0, rest;
    for (int64_t i = 0; i < count; i++) sum += indices[i];
    sum = 2 * sum + count;
    rest = sum % (2 * count);
    return (sum - (rest < 0 ? rest + 2 * count : rest)) / (2 * count);
}

/* The smaller of two in *best. */
static void take_smaller(packet *best, packet *other)
{
    if (best->size && other->size >= best->size) return;
    packet before = *best;
    *best = *other;
    *other = before;
}

static int write_best(search *s, const int32_t *sines, const double *limits, workshop *shop,
                      packet *best, packet *other)
{
    way ways[WAYS];
    int status = BAD_ERROR;
    int kept = BEST(rank)(s, sines, limits, ways);
    int count = kept < s->how.written ? kept : s->how.written;
    if (kept && ways[0].repeats && ways[0].bits < SPARSE * s->count) {
        way w = ways[0];
        w.repeats = 0;
        status = put_packet(s, &w, shop, best);
        if (status == NO_MEMORY) return status;
        if (status) best->size = 0;
        else if (count == 1 && best->coding == BY_BITS) return status;
    }
    for (int k = 0; k < count; k++) {
        int found = put_packet(s, ways + k, shop, other);
        if (found == NO_MEMORY) return found;
        if (!found) take_smaller(best, other);
    }
    if (best->size) return DONE;
    /* An error too large in what no estimate looked at. */
    polynomial_way(ways, 0, 0);
    return put_packet(s, ways, shop, best);
}

static int encode_all(search *s, const int32_t *sines, const double *limits, packet *best, packet *other)
{
    workshop shop = {0};
    double *rows = NULL;
    int64_t each = s->count + FRONT, same = 1;
    while (same < s->count && s->indices[same] == s->indices[0]) same++;
    best->bytes = malloc((size_t)best->room);
    if (!best->bytes) return NO_MEMORY;
    s->first = s->indices[0];
    if (same == s->count) {
        way w = {0};
        best->size = put_header(best->bytes, CONSTANT, &w, s->first);
        return DONE;
    }
    s->mean = mean_of(s->indices, s->count);
    other->bytes = malloc((size_t)other->room);
    rows = malloc((size_t)(2 * each + s->count / PART + 4) * sizeof *rows);
    int status = NO_MEMORY;
    if (other->bytes && rows && workshop_open(&shop, s->count)) {
        s->rows[0] = rows;
        s->rows[1] = rows + each;
        s->gains = rows + 2 * each;
        status = write_best(s, sines, limits, &shop, best, other);
    }
    workshop_close(&shop);
    free(rows);
    return status;
}

/* Whether these are tables of sines and of the limits between reflection coefficients. */
static int are_tables(const Py_buffer *sines, const Py_buffer *limits)
{
    int fits = whole(sines, 4) && sines->len == 4 * 128 && whole(limits, 8) && limits->len == 8 * 127;
    for (int i = 0; fits && i < 128; i++) {
        int32_t sine = ((int32_t *)sines->buf)[i];
        fits = sine >= 0 && sine < 32768;
    }
    return fits;
}

/* Whether these are indices of a packet. */
static int is_row(const Py_buffer *indices)
{
    int64_t count = indices->len / 8;
    return whole(indices, 8) && count && count < (int64_t)1 << 29 &&
           within(indices->buf, count, INDEX_LIMIT);
}

/* (indices int64, sines int32 [128], limits float64 [127], highest order, stride, sets, whether other
   orders are tried, packets written) -> the packet */
static PyObject *encode_packet(PyObject *self, PyObject *args)
{
    (void)self;
    Py_buffer indices, sines, limits;
    search s = {0};
    if (!PyArg_ParseTuple(args, "y*y*y*iiipi", &indices, &sines, &limits, &s.how.orders, &s.how.stride,
                          &s.how.sets, &s.how.other, &s.how.written))
        return NULL;
    PyObject *result = NULL;
    s.indices = indices.buf;
    s.count = indices.len / 8;
    int fits = is_row(&indices) && are_tables(&sines, &limits) && s.how.orders >= 0 &&
               s.how.orders <= ORDERS && s.how.stride > 0 && s.how.stride <= 64 &&
               !(s.how.sets >> SETS) && s.how.written > 0;
    if (!fits)
        PyErr_SetString(PyExc_ValueError, "not indices that a packet holds, or not a search");
    else {
        packet best = {NULL, 8 * s.count + 512, 0, 0}, other = best;
        int status;
        Py_BEGIN_ALLOW_THREADS
        status = encode_all(&s, sines.buf, limits.buf, &best, &other);
        Py_END_ALLOW_THREADS
        if (status == DONE) result = PyBytes_FromStringAndSize((char *)best.bytes, (Py_ssize_t)best.size);
        else if (status == NO_MEMORY) PyErr_NoMemory();
        else PyErr_SetString(PyExc_ValueError, "a magnitude of 2^34 or more");
        free(best.bytes);
        free(other.bytes);
    }
    PyBuffer_Release(&indices);
    PyBuffer_Release(&sines);
    PyBuffer_Release(&limits);
    return result;
}

/* BIT times the bits of the best of the first three polynomials, signs too; -1: none can be coded. */
static int64_t polynomial_bits(const int64_t *indices, int64_t count)
{
    int64_t bits[3] = {0}, best = -1, mean = mean_of(indices, count);
    double x[3][2 + PART];
    for (int64_t from = 0; from < count; from += PART) {
        int64_t n = count - from < PART ? count - from : PART;
        for (int64_t i = -2; i < n; i++) {
            int64_t now = from + i < 0 ? 0 : from + i, before = now ? now - 1 : 0;
            x[0][2 + i] = (double)(indices[now] - mean);
            x[1][2 + i] = (double)(indices[now] - indices[before]);
            x[2][2 + i] = i > -2 ? x[1][2 + i] - x[1][1 + i] : 0;
        }
        for (int g = 0; g < 3; g++) {
            int64_t some = 0;
            for (int64_t i = 0; i < n; i++) some += x[g][2 + i] != 0;
            add_bits(x[g] + 2, n, bits + g);
            if (bits[g] >= 0) bits[g] += BIT * some;
        }
    }
    for (int g = 0; g < 3; g++)
        if (bits[g] >= 0 && (best < 0 || bits[g] < best)) best = bits[g];
    return best;
}

/* (indices int64) -> bits, as polynomial_bits() has them */
static PyObject *polynomial_bits_(PyObject *self, PyObject *args)
{
    (void)self;
    Py_buffer indices;
    int64_t bits = -2;
    if (!PyArg_ParseTuple(args, "y*", &indices)) return NULL;
    if (is_row(&indices)) {
        Py_BEGIN_ALLOW_THREADS
        bits = polynomial_bits(indices.buf, indices.len / 8);
        Py_END_ALLOW_THREADS
    }
    PyBuffer_Release(&indices);
    if (bits == -2) return PyErr_Format(PyExc_ValueError, "not indices that a packet holds");
    return PyFloat_FromDouble(bits < 0 ? HUGE_VAL : (double)bits);
}

/* (indices int64, sines int32 [128], limits float64 [127], starts int64 [16]) -> how many packets are
   smaller than one */
static PyObject *find_cuts_(PyObject *self, PyObject *args)
{
    (void)self;
    Py_buffer indices, sines, limits, starts;
    int found = 0;
    if (!PyArg_ParseTuple(args, "y*y*y*w*", &indices, &sines, &limits, &starts)) return NULL;
    if (is_row(&indices) && are_tables(&sines, &limits) && whole(&starts, 8) && starts.len == 8 * PIECES) {
        Py_BEGIN_ALLOW_THREADS
        found = find_cuts(indices.buf, indices.len / 8, sines.buf, limits.buf, starts.buf);
        Py_END_ALLOW_THREADS
    }
    PyBuffer_Release(&indices);
    PyBuffer_Release(&sines);
    PyBuffer_Release(&limits);
    PyBuffer_Release(&starts);
    if (!found) return PyErr_Format(PyExc_ValueError, "not indices that a packet holds");
    return PyLong_FromLong(found);
}

/* Bits a sample of each piece, added up: of the best of the first three differences. */
static double piece_bits(const double *x, int64_t pieces, int64_t size)
{
    double total = 0;
    for (int64_t k = 0; k < pieces; k++, x += size) {
        double sum = 0, sums[3] = {0}, least = 0;
        for (int64_t i = 0; i < size; i++) sum += x[i];
        double mean = floor(sum / (double)size);
        for (int64_t i = 0; i < size; i++) {
            double now = x[i] - mean, before = i ? x[i - 1] - mean : 0, older = i > 1 ? x[i - 2] - mean : 0;
            sums[0] += size_of(now);
            if (i) sums[1] += size_of(now - before);
            if (i > 1) sums[2] += size_of((now - before) - (before - older));
        }
        for (int g = 0; g < 3 && g < size; g++) {
            double bits = log_2(1 + 5.4 * (sums[g] / (double)(size - g)));
            least = !g || bits < least ? bits : least;
        }
        total += least;
    }
    return total;
}

/* (whole numbers float64 [pieces, samples], pieces) -> bits a sample, added up over all pieces */
static PyObject *piece_bits_(PyObject *self, PyObject *args)
{
    (void)self;
    Py_buffer numbers;
    long long pieces;
    double found = -1;
    if (!PyArg_ParseTuple(args, "y*L", &numbers, &pieces)) return NULL;
    if (whole(&numbers, 8) && numbers.len && pieces > 0 && numbers.len / 8 % pieces == 0)
        found = piece_bits(numbers.buf, pieces, numbers.len / 8 / pieces);
    PyBuffer_Release(&numbers);
    if (found < 0) return PyErr_Format(PyExc_ValueError, "not pieces of whole numbers");
    return PyFloat_FromDouble(found);
}

PyMethodDef hapfmt_packet_methods[] = {
    {"piece_bits", piece_bits_, METH_VARARGS, NULL},
    {"find_cuts", find_cuts_, METH_VARARGS, NULL},
    {"polynomial_bits", polynomial_bits_, METH_VARARGS, NULL},
    {"encode_packet", encode_packet, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL},
};
