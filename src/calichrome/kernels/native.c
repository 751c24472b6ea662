/*
 * The colour and geometry of whole frames in one pass, see correct.h, and frames of videos from
 * YUV and back, see yuv.h.
 *
 * A plan is compiled once and only read afterwards, so any number of threads may run it.
 */
#define Py_LIMITED_API 0x030b0000
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <math.h>
#include <string.h>

#include "plan.h"

#define WIDE 0
#include "lanes.h"
#include "correct.h"
#include "yuv.h"
#undef WIDE

#if defined(__x86_64__)
#define HAS_WIDE 1
#include <immintrin.h>
#define WIDE 1
#include "lanes.h"
#include "correct.h"
#include "yuv.h"
#undef WIDE
#else
#define HAS_WIDE 0
#endif

static const char CAPSULE[] = "calichrome.kernels.plan";

static void free_plan(plan_t *plan) {
    free(plan->map.nodes);
    free(plan->gain.nodes);
    free(plan->linear);
    free(plan->table);
    free(plan);
}

static void free_capsule(PyObject *capsule) {
    free_plan(PyCapsule_GetPointer(capsule, CAPSULE));
}

/* A copy of float32 values; NULL with an exception set if their number is another. */
static float *copied(const Py_buffer *values, Py_ssize_t count, const char *name) {
    if (values->len != count * (Py_ssize_t)sizeof(float)) {
        PyErr_Format(PyExc_ValueError, "%s: expected %zd float32, got %zd bytes", name, count,
                     values->len);
        return NULL;
    }
    float *copy = malloc((size_t)values->len + 1);
    if (!copy) {
        PyErr_NoMemory();
        return NULL;
    }
    memcpy(copy, values->buf, (size_t)values->len);
    return copy;
}

static int read_floats(float *out, const Py_buffer *values, Py_ssize_t count, const char *name) {
    float *copy = copied(values, count, name);
    if (!copy) return 0;
    memcpy(out, copy, (size_t)count * sizeof(float));
    free(copy);
    return 1;
}

static int read_grid(grid_t *grid, const plan_t *plan, int step, int n_planes,
                     const Py_buffer *nodes, const char *name) {
    if (step == 0) return 1;
    if (step != 1 && step != 2 && step != 4 && step != MAX_STEP) {
        PyErr_Format(PyExc_ValueError, "%s: step %d is not 1, 2, 4 or 8", name, step);
        return 0;
    }
    ptrdiff_t width = (plan->out_width - 1 + step - 1) / step + 1;
    grid->height = (plan->out_height - 1 + step - 1) / step + 1;
    float *given = copied(nodes, n_planes * grid->height * width, name);
    if (!given) return 0;
    grid->step = step;
    grid->n_planes = n_planes;
    grid->pitch = width + NODE_PADDING;
    size_t n_rows = (size_t)(n_planes * grid->height);
    grid->nodes = calloc(n_rows * (size_t)grid->pitch, sizeof(float));
    if (grid->nodes) {
        for (size_t row = 0; row < n_rows; ++row) {
            memcpy(grid->nodes + row * (size_t)grid->pitch, given + row * (size_t)width,
                   (size_t)width * sizeof(float));
        }
    } else {
        PyErr_NoMemory();
    }
    free(given);
    return grid->nodes != NULL;
}

static int read_terms(plan_t *plan, const Py_buffer *factors, const Py_buffer *coefficients) {
    Py_ssize_t count = factors->len / 3;
    if (factors->len % 3 || count > MAX_TERMS) {
        PyErr_Format(PyExc_ValueError, "factors: expected up to %d times 3 bytes", MAX_TERMS);
        return 0;
    }
    plan->n_terms = (int)count;
    memcpy(plan->factors, factors->buf, (size_t)factors->len);
    for (Py_ssize_t k = 0; k < factors->len; ++k) {
        int factor = ((const uint8_t *)factors->buf)[k];
        if (factor >= N_FACTORS) {
            PyErr_Format(PyExc_ValueError, "factors: there is no factor %d", factor);
            return 0;
        }
        if (factor >= 4 && factor <= 9) plan->features |= FEATURE_ROOTS;
        if (factor >= 7 && factor <= 9) plan->features |= FEATURE_CUBE_ROOTS;
        if (factor >= 10) plan->features |= FEATURE_HUE;
    }
    static const uint8_t PAIRS[3][3] = {{4, 5, 0}, {5, 6, 0}, {4, 6, 0}};
    plan->is_pairs = count == 3 && !memcmp(plan->factors, PAIRS, sizeof PAIRS);
    if (!read_floats(plan->coefficients[0], coefficients, 3 * count, "coefficients")) return 0;
    /* sqrt(a b) - (a + b) / 2 = -(sqrt a - sqrt b)^2 / 2: the lifted matrix takes the means off */
    for (int k = 0; k < 9; ++k) {
        plan->pair_matrix[k] = -0.25f / plan->lifted_grey * plan->coefficients[k % 3][k / 3];
    }
    return 1;
}

static int read_linear(plan_t *plan, const Py_buffer *tables) {
    Py_ssize_t count = tables->len / (3 * (Py_ssize_t)sizeof(float));
    if (plan->linearisation != BY_TABLE) return 1;
    if (count < 2) {
        PyErr_SetString(PyExc_ValueError, "linear: expected two entries or more");
        return 0;
    }
    float *given = copied(tables, 3 * count, "linear");
    if (!given) return 0;
    plan->n_linear = (int)count;
    plan->linear = calloc((size_t)(3 * (count + 1)), sizeof(float));
    if (plan->linear) {
        size_t bytes = (size_t)count * sizeof(float);
        for (int c = 0; c < 3; ++c) {
            float *own = plan->linear + c * (count + 1);
            memcpy(own, given + c * count, bytes);
            own[count] = own[count - 1];
        }
    } else {
        PyErr_NoMemory();
    }
    free(given);
    return plan->linear != NULL;
}

static int read_table(plan_t *plan, int size, const Py_buffer *nodes) {
    if (size == 0) return 1;
    if (size < 2 || size > 129) {
        PyErr_SetString(PyExc_ValueError, "table: expected 2 to 129 nodes along an edge");
        return 0;
    }
    Py_ssize_t count = (Py_ssize_t)size * size * size;
    plan->table = copied(nodes, 4 * count, "table");
    plan->table_size = size;
    return plan->table != NULL;
}

static int is_type(int type) { return type == UINT8 || type == UINT16 || type == FLOAT32; }

static PyObject *compile_plan(PyObject *self, PyObject *args, PyObject *keywords) {
    (void)self;
    static char *names[] = {
        "in_size_wh", "out_size_wh", "n_channels", "in_type",  "out_type",     "is_bgr",
        "has_colour", "clips",       "full_scale", "out_scale", "map_step",    "map_nodes",
        "gain_step",  "gain_nodes",  "balance",    "linearisation", "curve", "curve_foot", "linear", "matrix", "offset",
        "lift",       "lifted_grey", "lifted_matrix", "factors", "coefficients", "table_size",
        "table_scale", "table",      "is_encoded", "encoding", "encoding_foot", NULL};
    enum { MAP, GAIN, BALANCE, CURVE, TONES, MATRIX, OFFSET, LIFTED, FACTORS, COEFFICIENTS, TABLE_SCALE,
           TABLE, ENCODING, N_BUFFERS };
    Py_buffer b[N_BUFFERS];
    memset(b, 0, sizeof b);
    int map_step, gain_step, table_size, in_wh[2], out_wh[2];
    plan_t *plan = calloc(1, sizeof *plan);
    if (!plan) return PyErr_NoMemory();
    PyObject *capsule = NULL;
    int read = PyArg_ParseTupleAndKeywords(
        args, keywords, "$(ii)(ii)iiipppffiy*iy*y*iy*(ff)y*y*y*ffy*y*y*iy*y*py*(ff):compile_plan", names,
        &in_wh[0], &in_wh[1], &out_wh[0], &out_wh[1], &plan->n_channels, &plan->in_type,
        &plan->out_type, &plan->is_bgr, &plan->has_colour, &plan->clips,
        &plan->full_scale, &plan->out_scale, &map_step, &b[MAP], &gain_step, &b[GAIN],
        &b[BALANCE], &plan->linearisation, &b[CURVE], &plan->curve.foot_end,
        &plan->curve.foot_slope, &b[TONES], &b[MATRIX], &b[OFFSET], &plan->lift, &plan->lifted_grey,
        &b[LIFTED], &b[FACTORS], &b[COEFFICIENTS], &table_size, &b[TABLE_SCALE], &b[TABLE],
        &plan->is_encoded, &b[ENCODING], &plan->encoding.foot_end, &plan->encoding.foot_slope);
    if (read) {
        plan->in_width = in_wh[0], plan->in_height = in_wh[1];
        plan->out_width = out_wh[0], plan->out_height = out_wh[1];
        int sane = in_wh[0] > 0 && in_wh[1] > 0 && out_wh[0] > 0 && out_wh[1] > 0 &&
                   (plan->n_channels == 3 || (plan->n_channels == 1 && !plan->has_colour)) &&
                   is_type(plan->in_type) && is_type(plan->out_type) &&
                   plan->full_scale > 0 &&
                   (map_step > 0 || (in_wh[0] == out_wh[0] && in_wh[1] == out_wh[1]));
        if (!sane) PyErr_SetString(PyExc_ValueError, "compile_plan: the parts do not fit together");
        if (sane && read_grid(&plan->map, plan, map_step, 2, &b[MAP], "map_nodes") &&
            read_grid(&plan->gain, plan, gain_step, 3, &b[GAIN], "gain_nodes") &&
            read_floats(plan->balance, &b[BALANCE], 3, "balance") &&
            read_linear(plan, &b[TONES]) &&
            read_floats(plan->matrix, &b[MATRIX], 9, "matrix") &&
            read_floats(plan->offset, &b[OFFSET], 3, "offset") &&
            read_floats(plan->lifted_matrix, &b[LIFTED], 9, "lifted_matrix") &&
            read_terms(plan, &b[FACTORS], &b[COEFFICIENTS]) &&
            read_floats(plan->table_scale, &b[TABLE_SCALE], 3, "table_scale") &&
            read_table(plan, table_size, &b[TABLE]) &&
            read_floats(plan->curve.powers, &b[CURVE], N_POWERS, "curve") &&
            read_floats(plan->encoding.powers, &b[ENCODING], N_POWERS, "encoding")) {
            capsule = PyCapsule_New(plan, CAPSULE, free_capsule);
        }
    }
    for (int k = 0; k < N_BUFFERS; ++k) PyBuffer_Release(&b[k]);
    if (!capsule) free_plan(plan);
    return capsule;
}

/* Whether the buffer is a picture of that size whose pixels lie side by side. */
static int is_picture(const Py_buffer *buffer, ptrdiff_t height, ptrdiff_t width, int n_channels,
                      int type) {
    int n_axes = n_channels == 3 ? 3 : 2;
    ptrdiff_t pixel = (ptrdiff_t)n_channels * type;
    return buffer->ndim == n_axes && buffer->itemsize == type && buffer->shape[0] == height &&
           buffer->shape[1] == width && (n_axes == 2 || buffer->shape[2] == 3) &&
           (width == 1 || buffer->strides[1] == pixel) &&
           (n_axes == 2 || buffer->strides[2] == type) && buffer->strides[0] % type == 0 &&
           (uintptr_t)buffer->buf % (uintptr_t)type == 0;
}

#if HAS_WIDE
static int has_wide_lanes(void) {
    return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
}
#endif

static PyObject *run(PyObject *self, PyObject *args) {
    (void)self;
    PyObject *capsule, *source_object, *out_object;
    Py_ssize_t first, last;
    int wide;
    if (!PyArg_ParseTuple(args, "OOOnnp:run", &capsule, &source_object, &out_object, &first, &last,
                          &wide)) {
        return NULL;
    }
    const plan_t *plan = PyCapsule_GetPointer(capsule, CAPSULE);
    if (!plan) return NULL;
    Py_buffer source, out;
    if (PyObject_GetBuffer(source_object, &source, PyBUF_STRIDED_RO) < 0) return NULL;
    if (PyObject_GetBuffer(out_object, &out, PyBUF_STRIDED) < 0) {
        PyBuffer_Release(&source);
        return NULL;
    }
    int fits = is_picture(&source, plan->in_height, plan->in_width, plan->n_channels, plan->in_type) &&
               is_picture(&out, plan->out_height, plan->out_width, plan->n_channels,
                          plan->out_type) &&
               first >= 0 && last <= plan->out_height;
    if (fits) {
        rows_function *rows = correct_rows_portable;
#if HAS_WIDE
        if (wide && has_wide_lanes()) rows = correct_rows_wide;
#endif
        Py_BEGIN_ALLOW_THREADS
        rows(plan, (picture_t){source.buf, source.strides[0]}, (picture_t){out.buf, out.strides[0]},
             first, last);
        Py_END_ALLOW_THREADS
    } else {
        PyErr_SetString(PyExc_ValueError, "run: a picture or its rows do not fit the plan");
    }
    PyBuffer_Release(&source);
    PyBuffer_Release(&out);
    if (!fits) return NULL;
    Py_RETURN_NONE;
}

static picture_t picture_of(const Py_buffer *buffer) {
    return (picture_t){buffer->buf, buffer->strides[0]};
}

/* What both ways share; one of planes and picture is written. */
static PyObject *convert(PyObject *args, int to_rgb) {
    enum { LUMA, CHROMA, RGB = CHROMA + 2, MATRIX, N_BUFFERS };
    PyObject *objects[N_BUFFERS];
    Py_buffer b[N_BUFFERS];
    int wide = 1, n_read = 0;
    if (!PyArg_ParseTuple(args, "OOOOO|p", &objects[LUMA], &objects[CHROMA], &objects[CHROMA + 1],
                          &objects[RGB], &objects[MATRIX], &wide)) {
        return NULL;
    }
    while (n_read < N_BUFFERS) {
        int is_written = n_read != MATRIX && (n_read == RGB) == to_rgb;
        int access = is_written ? PyBUF_STRIDED : PyBUF_STRIDED_RO;
        if (PyObject_GetBuffer(objects[n_read], &b[n_read], access) < 0) break;
        ++n_read;
    }
    int fits = 0;
    if (n_read == N_BUFFERS) {
        ptrdiff_t height = b[LUMA].ndim == 2 ? b[LUMA].shape[0] : 0;
        ptrdiff_t width = b[LUMA].ndim == 2 ? b[LUMA].shape[1] : 0;
        fits = width > 0 && height > 0 && (to_rgb || (width % 2 == 0 && height % 2 == 0)) &&
               is_picture(&b[LUMA], height, width, 1, UINT8) &&
               is_picture(&b[CHROMA], (height + 1) / 2, (width + 1) / 2, 1, UINT8) &&
               is_picture(&b[CHROMA + 1], (height + 1) / 2, (width + 1) / 2, 1, UINT8) &&
               is_picture(&b[RGB], height, width, 3, UINT8);
        yuv_t frame = {.width = width, .height = height};
        if (!fits) {
            PyErr_SetString(PyExc_ValueError, "the planes and the picture do not fit together");
        } else if ((fits = read_floats(frame.matrix[0], &b[MATRIX], 12, "matrix"))) {
            frame.luma = picture_of(&b[LUMA]), frame.rgb = picture_of(&b[RGB]);
            for (int k = 0; k < 2; ++k) frame.chroma[k] = picture_of(&b[CHROMA + k]);
            yuv_function *rows = to_rgb ? rgb_rows_portable : yuv_rows_portable;
#if HAS_WIDE
            if (wide && has_wide_lanes()) rows = to_rgb ? rgb_rows_wide : yuv_rows_wide;
#endif
            Py_BEGIN_ALLOW_THREADS
            rows(&frame);
            Py_END_ALLOW_THREADS
        }
    }
    while (n_read > 0) PyBuffer_Release(&b[--n_read]);
    if (!fits) return NULL;
    Py_RETURN_NONE;
}

static PyObject *rgb_of_yuv(PyObject *self, PyObject *args) {
    (void)self;
    return convert(args, 1);
}

static PyObject *yuv_of_rgb(PyObject *self, PyObject *args) {
    (void)self;
    return convert(args, 0);
}

static PyMethodDef METHODS[] = {
    {"compile_plan", (PyCFunction)(void (*)(void))compile_plan, METH_VARARGS | METH_KEYWORDS,
     "Copy everything that a correction needs."},
    {"run", run, METH_VARARGS, "Correct some rows of a picture; other threads go on meanwhile."},
    {"rgb_of_yuv", rgb_of_yuv, METH_VARARGS, "Convert a whole frame of 4:2:0 to a picture."},
    {"yuv_of_rgb", yuv_of_rgb, METH_VARARGS, "Convert a picture to a whole frame of 4:2:0."},
    {NULL, NULL, 0, NULL}};

static struct PyModuleDef MODULE = {PyModuleDef_HEAD_INIT, "native", NULL, 0, METHODS, NULL, NULL,
                                    NULL, NULL};

PyMODINIT_FUNC PyInit_native(void) { return PyModule_Create(&MODULE); }
