/* The low-pass of hapfmt/split.py. The readable twin is filtered_plain there. Both take the same steps
   in the same order, in doubles without contraction (setup.py), so they agree in every bit. */
#include "kernels.h"

enum { MOST_SECTIONS = 8 };

static void filter_one(const double *sections, Py_ssize_t count, const double *state, double *x,
                       Py_ssize_t ticks)
{
    double b[MOST_SECTIONS][3], a[MOST_SECTIONS][2], held[MOST_SECTIONS][2];
    for (Py_ssize_t s = 0; s < count; s++) {
        memcpy(b[s], sections + 6 * s, sizeof b[s]);
        memcpy(a[s], sections + 6 * s + 4, sizeof a[s]);
        memcpy(held[s], state + 2 * s, sizeof held[s]);
    }
    for (Py_ssize_t n = 0; n < ticks; n++) {
        double given = x[n];
        for (Py_ssize_t s = 0; s < count; s++) {
            const double made = b[s][0] * given + held[s][0];
            held[s][0] = b[s][1] * given - a[s][0] * made + held[s][1];
            held[s][1] = b[s][2] * given - a[s][1] * made;
            given = made;
        }
        x[n] = given;
    }
}

/* (sections: float64 [count, 6], state: float64 [columns, count, 2], x: float64 [columns, ticks]). Each
   column of x passes all sections, from its own state; x is overwritten. */
static PyObject *filter_sections(PyObject *self, PyObject *args)
{
    Py_buffer sections, state, x;
    (void)self;
    if (!PyArg_ParseTuple(args, "y*y*w*", &sections, &state, &x)) return NULL;
    const Py_ssize_t count = sections.len / 48;
    const Py_ssize_t columns = count ? state.len / (16 * count) : 0;
    const int fits = whole(&sections, 8) && whole(&state, 8) && whole(&x, 8) && count > 0 &&
                     count <= MOST_SECTIONS && sections.len == 48 * count && columns > 0 &&
                     state.len == 16 * count * columns && x.len % (8 * columns) == 0;
    if (fits) {
        const Py_ssize_t ticks = x.len / (8 * columns);
        Py_BEGIN_ALLOW_THREADS
        for (Py_ssize_t c = 0; c < columns; c++)
            filter_one(sections.buf, count, (const double *)state.buf + 2 * count * c,
                       (double *)x.buf + ticks * c, ticks);
        Py_END_ALLOW_THREADS
    } else
        PyErr_SetString(PyExc_ValueError, "not sections, a state for each column, and columns");
    PyBuffer_Release(&sections);
    PyBuffer_Release(&state);
    PyBuffer_Release(&x);
    if (!fits) return NULL;
    Py_RETURN_NONE;
}

PyMethodDef hapfmt_sections_methods[] = {
    {"filter_sections", filter_sections, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL},
};
