/* The function that looks for a predictor with little work, as Python calls it. */
#include "kernels.h"

#if defined(__GNUC__)
/* Not every function of the headers is used here. */
#pragma GCC diagnostic ignored "-Wunused-function"
#endif

#include "quick.h"

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
