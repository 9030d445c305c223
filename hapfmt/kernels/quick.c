/* A quick choice of a packet's predictor. The readable twin is hapfmt/encoder/predict.py. */
#include "kernels.h"

#if defined(__GNUC__)
/* Not every function of the headers is used here. */
#pragma GCC diagnostic ignored "-Wunused-function"
#endif

#include "search.h"

enum { QUICK_BLOCK = 32, U_BITS = 35 };
static const double QUICK_NOISE = 1e-6;
enum { QUICK_ORDERS = 12, QUICK_POLYNOMIALS = 3, WEIGHED = 256, WEIGHED_OF = 4 };

INLINE uint64_t zigzag(int64_t e)
{
    return (uint64_t)e << 1 ^ (uint64_t)(e >> 63);
}

/* filter_init() with as few zeros in front as make the coefficients a multiple of 4. */
static void short_filter(filter *f, const plan *p)
{
    int spare;
    filter_init(f, p);
    spare = f->width - ((p->order + 3) & ~3);
    memmove(f->taps, f->taps + spare, (size_t)(ORDERS - spare) * sizeof *f->taps);
    memmove(f->real_taps, f->real_taps + spare, (size_t)(ORDERS - spare) * sizeof *f->real_taps);
    f->width -= spare;
}

/* x[0 ... ROOM + n - 1]: first differences of a piece, after those of the ROOM indices before it. */
INLINE void quick_differences(const int64_t *indices, int64_t from, int64_t n, int64_t *y)
{
    int64_t room = from < ROOM ? from : ROOM;
    memset(y, 0, (size_t)(ROOM - room) * sizeof *y);
    for (int64_t i = -room; i < n; i++)
        y[ROOM + i] = from + i ? indices[from + i] - indices[from + i - 1] : 0;
}

/* Autocorrelation of the first differences, lags 0 to 12, of one piece in two where there are more than
   four. Each is divided by its own energy, since bits go by its logarithm; 18 bits make sums exact. */
static void quick_sums(const int64_t *indices, int64_t count, double *r)
{
    double x[ROOM + PIECE], a[QUICK_LAGS];
    int64_t y[ROOM + PIECE], stride = count > 4 * PIECE ? 2 * PIECE : PIECE;
    for (int k = 0; k < LAGS; k++) r[k] = 0;
    for (int64_t from = 0; from < count; from += stride) {
        int64_t n = count - from < PIECE ? count - from : PIECE;
        uint64_t most = 0;
        quick_differences(indices, from, n, y);
        for (int64_t i = 0; i < ROOM + n; i++) most |= zigzag(y[i]);
        int shift = bit_length(most >> 1) - SCALED_BITS;
        if (shift < 0) shift = 0;
        for (int64_t i = 0; i < ROOM + n; i++) x[i] = (double)(y[i] >> shift);
        products(x + ROOM, x + ROOM - (QUICK_LAGS - 1), n, QUICK_LAGS, a);
        double energy = a[QUICK_LAGS - 1] + (double)n;
        for (int k = 0; k <= QUICK_ORDERS; k++) r[k] += a[QUICK_LAGS - 1 - k] / energy;
    }
}

/* 256 times about the bits of prediction errors, of one piece in four where there are more than four;
   -1: beyond what can be coded. */
static int64_t weigh(const plan *p, const int64_t *indices)
{
    filter f;
    int64_t y[ORDERS + WEIGHED] = {0}, e[WEIGHED], sum = 0;
    int stride = p->span > WEIGHED * WEIGHED_OF ? WEIGHED_OF : 1;
    short_filter(&f, p);
    for (int64_t from = 0; from < p->span; from += stride * WEIGHED) {
        int64_t count = p->span - from < WEIGHED ? p->span - from : WEIGHED;
        differences(indices, from, count, p->difference, p->base, y + ORDERS);
        if (stride > 1 && from) differences(indices, from - ORDERS, ORDERS, p->difference, p->base, y);
        errors_of(&f, y, count, e);
        memmove(y, y + count, ORDERS * sizeof *y);
        for (int64_t at = 0; at < count; at += QUICK_BLOCK) {
            int64_t end = count - at < QUICK_BLOCK ? count : at + QUICK_BLOCK;
            uint64_t most = 0, all = 0;
            for (int64_t i = at; i < end; i++) {
                uint64_t u = zigzag(e[i]);
                most |= u;
                all += u;
            }
            if (most >> U_BITS) return -1;
            sum += log_of(QUICK_BLOCK + 2 * all);
        }
    }
    return sum;
}

/* The predictor of a packet whose indices lie within INDEX_LIMIT: difference; reflections [12] and their
   coefficients, *order of them. */
static int choose(const int64_t *indices, int64_t count, const int32_t *sines, const double *limits,
                  const double *costs, int8_t *reflections, int32_t *coefficients, int *order)
{
    int64_t best = -1;
    double r[LAGS], energies[ORDERS], least = 0;
    int8_t found[ORDERS];
    plan p = {0};
    int g = 0;
    p.span = count;
    p.limit = INDEX_LIMIT;
    p.base = indices[0];
    for (int d = 0; d <= QUICK_POLYNOMIALS; d++) {
        p.difference = d;
        int64_t size = weigh(&p, indices);
        if (size < 0 || (best >= 0 && size >= best)) {
            if (d > 1) break;
            continue;
        }
        best = size;
        g = d;
    }
    *order = 0;
    quick_sums(indices, count, r);
    r[0] *= 1 + QUICK_NOISE;
    int most = count - 1 < QUICK_ORDERS ? (int)(count - 1) : QUICK_ORDERS, m = 0;
    int there = levinson(r, most, limits, found, energies);
    /* The last whose energy repays its coefficients. */
    for (int n = 1; n <= there; n++)
        if (energies[n - 1] > 0 && (!m || energies[n - 1] * costs[n - 1] < least)) {
            least = energies[n - 1] * costs[n - 1];
            m = n;
        }
    if (m && step_up(found, m, sines, coefficients)) {
        p.difference = 1;
        p.order = m;
        p.coefficients = coefficients;
        int64_t size = weigh(&p, indices);
        if (size >= 0 && (best < 0 || size < best)) {
            *order = m;
            memcpy(reflections, found, (size_t)m);
            g = 1;
        }
    }
    return g;
}

/* (indices int64, sines int32, limits float64 [127], costs float64 [12], reflections int8 [12],
   coefficients int32 [12]) -> (difference, order) */
static PyObject *quick_predictor(PyObject *self, PyObject *args)
{
    (void)self;
    Py_buffer indices, sines, limits, costs, reflections, coefficients;
    int difference = 0, order = 0;
    if (!PyArg_ParseTuple(args, "y*y*y*y*w*w*", &indices, &sines, &limits, &costs, &reflections,
                          &coefficients))
        return NULL;
    PyObject *result = NULL;
    int fits = whole(&indices, 8) && indices.len && whole(&sines, 4) && sines.len == 4 * 128 &&
               whole(&limits, 8) && limits.len == 8 * 127 && whole(&costs, 8) &&
               costs.len == 8 * QUICK_ORDERS && reflections.len == QUICK_ORDERS &&
               whole(&coefficients, 4) && coefficients.len == 4 * QUICK_ORDERS &&
               within(indices.buf, indices.len / 8, INDEX_LIMIT);
    for (int i = 0; fits && i < 128; i++) {
        int32_t sine = ((int32_t *)sines.buf)[i];
        fits = sine >= 0 && sine < 32768;
    }
    if (!fits)
        PyErr_SetString(PyExc_ValueError, "not the arrays that a predictor is chosen with");
    else {
        Py_BEGIN_ALLOW_THREADS
        difference = choose(indices.buf, indices.len / 8, sines.buf, limits.buf, costs.buf,
                            reflections.buf, coefficients.buf, &order);
        Py_END_ALLOW_THREADS
        result = Py_BuildValue("ii", difference, order);
    }
    PyBuffer_Release(&indices);
    PyBuffer_Release(&sines);
    PyBuffer_Release(&limits);
    PyBuffer_Release(&costs);
    PyBuffer_Release(&reflections);
    PyBuffer_Release(&coefficients);
    return result;
}

PyMethodDef hapfmt_quick_methods[] = {
    {"quick_predictor", quick_predictor, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL},
};
