/* Rice codes of LPCR: the functions that Python calls, as in lpcr.c. */
#include "kernels.h"

#if defined(__GNUC__)
/* Of the headers, not all is needed here. */
#pragma GCC diagnostic ignored "-Wunused-function"
#endif

#include "rice.h"

/* (bytes or writable buffer, coefficients int32, difference, base, limit, indices int64) ->
   (status, bytes read or written) */
static PyObject *run(PyObject *args, int decoding)
{
    Py_buffer data, coefficients, indices;
    plan p = {0};
    int status = DONE;
    long long base, limit;
    int64_t size = 0;
    const char *format = decoding ? "y*y*iLLw*" : "w*y*iLLy*";
    if (!PyArg_ParseTuple(args, format, &data, &coefficients, &p.difference, &base, &limit, &indices))
        return NULL;
    PyObject *result = NULL;
    p.order = coefficients.len > 4 * ORDERS ? ORDERS + 1 : (int)(coefficients.len / 4);
    p.base = base;
    p.limit = limit;
    p.span = indices.len / 8;
    p.coefficients = coefficients.buf;
    if (!whole(&coefficients, 4) || !whole(&indices, 8) || !valid(&p))
        PyErr_SetString(PyExc_ValueError, "not a predictor, or not arrays of its integers");
    else {
        Py_BEGIN_ALLOW_THREADS
        if (decoding) {
            bits b = {data.buf, data.len, 0, 0, 0};
            status = unrice(&b, &p, indices.buf);
            if (!status && !ends(&b)) status = BAD_BITS;
            size = bytes_taken(&b);
        } else {
            bit_sink s = {data.buf, data.len, 0, 0, 0};
            status = rice(&s, &p, indices.buf, &size);
        }
        Py_END_ALLOW_THREADS
        result = Py_BuildValue("iL", status, (long long)size);
    }
    PyBuffer_Release(&data);
    PyBuffer_Release(&coefficients);
    PyBuffer_Release(&indices);
    return result;
}

static PyObject *rice_decode(PyObject *self, PyObject *args) { (void)self; return run(args, 1); }
static PyObject *rice_encode(PyObject *self, PyObject *args) { (void)self; return run(args, 0); }

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

PyMethodDef hapfmt_rice_methods[] = {
    {"rice_decode", rice_decode, METH_VARARGS, NULL},
    {"rice_encode", rice_encode, METH_VARARGS, NULL},
    {"quick_predictor", quick_predictor, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL},
};
