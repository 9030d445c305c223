/* Passes over all samples of a channel of doubles. The readable twins are in hapfmt/encoder/lattice.py. */
#include "kernels.h"

#include <math.h>

static const double LARGEST_COUNT = 2147483647.0, EXACT = 9007199254740992.0, WIDE = 4611686018427387904.0;

typedef struct {
    int64_t a, b;
    double step, d; /* step: a fraction of one, below which the neighbours are farther away */
} grid;

static inline double value_of(const grid *g, int64_t count)
{
    double wide = (double)count * (double)g->a;
    if (fabs(wide) + fabs((double)g->b) < WIDE) return (double)(count * g->a + g->b) / g->d;
    return (wide + (double)g->b) / g->d;
}

static inline int64_t nearest(const grid *g, double x)
{
    double guess = rint((x * g->d - (double)g->b) / (double)g->a);
    if (!(fabs(guess) < LARGEST_COUNT)) return 0;
    int64_t count = (int64_t)guess, best = count;
    double away = fabs(x - value_of(g, count));
    if (away <= g->step) return count;
    for (int shift = -1; shift <= 1; shift += 2) {
        double other = fabs(x - value_of(g, count + shift));
        if (other < away) {
            away = other;
            best = count + shift;
        }
    }
    return best;
}

/* (A, B, D, most that a sample may miss its count by, x: float64, counts: int32, filled)
   -> (the first sample that misses by more, or how many there are; the most of those before it;
   whether it is more than that double) */
static PyObject *nearest_within(PyObject *self, PyObject *args)
{
    long long a, b, d;
    double allowed, worst = 0;
    Py_buffer x, counts;
    int more = 0;
    (void)self;
    if (!PyArg_ParseTuple(args, "LLLdy*w*", &a, &b, &d, &allowed, &x, &counts)) return NULL;
    int fits = whole(&x, 8) && whole(&counts, 4) && 2 * counts.len == x.len && a && d > 0;
    Py_ssize_t size = x.len / 8, t = 0;
    if (fits) {
        const double *in = x.buf;
        int32_t *out = counts.buf;
        grid g = {a, b, 0.25 * fabs((double)a) / (double)d, (double)d};
        Py_BEGIN_ALLOW_THREADS
        for (; t < size; t++) {
            int64_t count = nearest(&g, in[t]);
            double given = value_of(&g, count), difference = in[t] - given, away = fabs(difference);
            out[t] = (int32_t)count;
            if (away == 0) continue;
            /* What the difference lacks: Knuth, section 4.2.2, theorem B. */
            double back = difference - in[t];
            double rest = (in[t] - (difference - back)) - (given + back);
            int above = difference > 0 ? rest > 0 : rest < 0;
            if (away > allowed || (above && away == allowed)) break;
            if (away > worst) more = 0;
            if (away >= worst) {
                worst = away;
                more |= above;
            }
        }
        Py_END_ALLOW_THREADS
    } else
        PyErr_SetString(PyExc_ValueError, "not doubles, and as many counts");
    PyBuffer_Release(&x);
    PyBuffer_Release(&counts);
    return fits ? Py_BuildValue("ndi", t, worst, more) : NULL;
}

/* (x: float64) -> (whether all are finite, whether one is -0.0, the smallest, the largest, and the
   one nearest to 0 that is not 0, without its sign; infinity where there is none) */
static PyObject *double_facts(PyObject *self, PyObject *args)
{
    Py_buffer x;
    (void)self;
    if (!PyArg_ParseTuple(args, "y*", &x)) return NULL;
    int fits = whole(&x, 8);
    const double *in = x.buf;
    double low = INFINITY, high = -INFINITY, least = INFINITY;
    uint64_t infinite = 0, negative = 0;
    if (fits) {
        Py_BEGIN_ALLOW_THREADS
        for (Py_ssize_t t = 0, size = x.len / 8; t < size; t++) {
            uint64_t bits;
            memcpy(&bits, in + t, 8);
            double size_of = fabs(in[t]);
            infinite |= !(size_of < INFINITY);
            negative |= bits == (uint64_t)1 << 63;
            low = in[t] < low ? in[t] : low;
            high = in[t] > high ? in[t] : high;
            least = size_of > 0 && size_of < least ? size_of : least;
        }
        Py_END_ALLOW_THREADS
    } else
        PyErr_SetString(PyExc_ValueError, "not doubles");
    PyBuffer_Release(&x);
    return fits ? Py_BuildValue("OOddd", infinite ? Py_False : Py_True,
                                negative ? Py_True : Py_False, low, high, least)
                : NULL;
}

/* The simplest fraction from low > 0 to high, as simplest_near in rational.py finds it. */
static void simplest(double low, double high, double *p, double *q)
{
    enum { TERMS = 40 };
    double terms[TERMS], first = ceil(low), n, m = 1;
    int count = 0;
    *p = 0;
    *q = 1;
    if (!(low <= high && high < EXACT)) return;
    while (first < EXACT && first > high && count < TERMS) {
        double term = first - 1, below = low;
        terms[count++] = term;
        low = 1 / (high - term);
        high = 1 / (below - term);
        first = ceil(low);
    }
    n = first;
    while (count > 0) {
        double before = n;
        n = terms[--count] * n + m;
        m = before;
    }
    *p = n;
    *q = m;
}

/* (least, most: float64 [differences], floor) -> the ends of their common step, in this order; None
   where it is below the floor. The twin is _divisor in hapfmt/encoder/rational.py. */
static PyObject *common_divisor(PyObject *self, PyObject *args)
{
    Py_buffer least, most;
    double floor_, a = 0, b = 0;
    int found = 1;
    (void)self;
    if (!PyArg_ParseTuple(args, "y*y*d", &least, &most, &floor_)) return NULL;
    int fits = whole(&least, 8) && whole(&most, 8) && least.len == most.len && least.len;
    const double *lows = least.buf, *highs = most.buf;
    if (fits) {
        a = lows[0];
        b = highs[0];
    }
    for (Py_ssize_t i = 0; fits && found && i < least.len / 8; i++) {
        double low = lows[i], high = highs[i], p, q;
        if (a <= 0 || b < floor_) {
            found = 0;
            break;
        }
        double times = rint((low + high) / (a + b));
        if (times >= 1 && low <= times * b && high >= times * a) {
            a = low / times > a ? low / times : a;
            b = high / times < b ? high / times : b;
            continue;
        }
        simplest(low / b, high / a, &p, &q);
        if (p == 0) {
            found = 0;
            break;
        }
        double one = a / q > low / p ? a / q : low / p, other = b / q < high / p ? b / q : high / p;
        a = one < other ? one : other;
        b = one < other ? other : one;
        found = b >= floor_;
    }
    PyBuffer_Release(&least);
    PyBuffer_Release(&most);
    if (!fits) {
        PyErr_SetString(PyExc_ValueError, "not as many doubles");
        return NULL;
    }
    if (!found) Py_RETURN_NONE;
    return Py_BuildValue("dd", a, b);
}

PyMethodDef hapfmt_lattice_methods[] = {
    {"common_divisor", common_divisor, METH_VARARGS, NULL},
    {"nearest_within", nearest_within, METH_VARARGS, NULL},
    {"double_facts", double_facts, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL},
};
