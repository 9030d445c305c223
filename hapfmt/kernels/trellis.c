/* MDCT, the encoder: the functions that Python calls, each with a readable twin there. */
#include "kernels.h"

#include "trellis.h"

static int valid_coding(int count, int classes, int start, const Py_buffer *rows)
{
    return count >= 1 && count <= SIZE_MOST && classes >= 0 && classes < 256 && start >= 0 &&
           start <= START_MOST && whole(rows, 8) && rows->len % (8 * (Py_ssize_t)count) == 0;
}

static int all_below(const int64_t *numbers, Py_ssize_t count, int bits, int negative)
{
    int64_t bound = (int64_t)1 << bits;
    for (Py_ssize_t i = 0; i < count; i++)
        if (numbers[i] >= bound || numbers[i] <= (negative ? -bound : -1)) return 0;
    return 1;
}

/* (targets int64 [blocks, count], count, classes, start, weight, magnitudes int64 [blocks, count],
   counts int64 [2, 36, 16]) -> (squared errors, 256 times the bits) */
static PyObject *mdct_trellis(PyObject *self, PyObject *args)
{
    (void)self;
    Py_buffer targets, magnitudes, seen;
    int count, classes, start, weight;
    if (!PyArg_ParseTuple(args, "y*iiiiw*w*", &targets, &count, &classes, &start, &weight, &magnitudes,
                          &seen))
        return NULL;
    PyObject *result = NULL;
    neighbours n;
    column *columns = NULL;
    spent total = {0, 0};
    if (!valid_coding(count, classes, start, &targets) || !whole(&magnitudes, 8) || !whole(&seen, 8) ||
        magnitudes.len != targets.len || seen.len != 8 * CODES || weight < 0 || weight > WEIGHT_MOST ||
        !all_below(targets.buf, targets.len / 8, TARGET_BITS, 0))
        PyErr_SetString(PyExc_ValueError, "not targets of a trellis, or no room for what it finds");
    else {
        const class_table *tables[2] = {hapfmt_classes + (classes & 15), hapfmt_classes + (classes >> 4)};
        Py_BEGIN_ALLOW_THREADS
        columns = malloc((size_t)count * sizeof *columns);
        if (columns) {
            neighbours_from(&n, count, count, start);
            total = run_trellis(&n, tables, targets.buf, targets.len / 8 / count, weight, columns,
                                magnitudes.buf, seen.buf);
        }
        Py_END_ALLOW_THREADS
        if (columns) result = Py_BuildValue("LL", (long long)total.errors, (long long)total.bits);
        else PyErr_NoMemory();
        free(columns);
    }
    PyBuffer_Release(&targets);
    PyBuffer_Release(&magnitudes);
    PyBuffer_Release(&seen);
    return result;
}

/* (levels int64 [blocks, count], count, classes, start, coded bytes) -> how many, or how many it takes */
static PyObject *mdct_encode(PyObject *self, PyObject *args)
{
    (void)self;
    Py_buffer levels, out;
    int count, classes, start;
    int64_t size = 0;
    if (!PyArg_ParseTuple(args, "y*iiiw*", &levels, &count, &classes, &start, &out)) return NULL;
    PyObject *result = NULL;
    neighbours n;
    uint16_t *codes = NULL, *words = NULL;
    share *shares = NULL;
    if (!valid_coding(count, classes, start, &levels) ||
        !all_below(levels.buf, levels.len / 8, ERROR_BITS, 1))
        PyErr_SetString(PyExc_ValueError, "not levels of a transform");
    else {
        const class_table *tables[2] = {hapfmt_classes + (classes & 15), hapfmt_classes + (classes >> 4)};
        Py_ssize_t symbols = levels.len / 8;
        Py_BEGIN_ALLOW_THREADS
        codes = malloc(2 * (size_t)(symbols + 8));
        words = malloc(2 * (size_t)(symbols + 16));
        shares = malloc(CODES * sizeof *shares);
        if (codes && words && shares) {
            neighbours_from(&n, count, count, start);
            size = put_levels(&n, tables, levels.buf, symbols / count, codes, words, shares, out.buf,
                              out.len);
        }
        Py_END_ALLOW_THREADS
        if (codes && words && shares) result = PyLong_FromLongLong(size);
        else PyErr_NoMemory();
        free(codes);
        free(words);
        free(shares);
    }
    PyBuffer_Release(&levels);
    PyBuffer_Release(&out);
    return result;
}

PyMethodDef hapfmt_trellis_methods[] = {
    {"mdct_trellis", mdct_trellis, METH_VARARGS, NULL},
    {"mdct_encode", mdct_encode, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL},
};
