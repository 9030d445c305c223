/* The extension module: the functions of all files, each behind a readable twin in Python. */
#include "kernels.h"

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, "_kernels", NULL, 0, NULL,
                                    NULL, NULL, NULL, NULL};

static PyMethodDef *const tables[] = {
    hapfmt_lpcr_methods, hapfmt_tube_methods, hapfmt_knots_methods, hapfmt_select_methods,
    hapfmt_huffman_methods, hapfmt_levels_methods, hapfmt_exact_methods, hapfmt_knots_coded_methods,
    hapfmt_packet_methods, hapfmt_transform_methods, hapfmt_trellis_methods, hapfmt_noise_methods,
    hapfmt_sections_methods, hapfmt_lattice_methods, hapfmt_deflate_methods,
    hapfmt_references_methods,
};

PyMODINIT_FUNC PyInit__kernels(void)
{
    PyObject *made = PyModule_Create(&module);
    hapfmt_lpcr_prepare();
    for (size_t i = 0; made && i < sizeof tables / sizeof *tables; i++)
        if (PyModule_AddFunctions(made, tables[i])) {
            Py_DECREF(made);
            made = NULL;
        }
    return made;
}
