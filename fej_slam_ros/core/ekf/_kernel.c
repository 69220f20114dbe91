// SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
// SPDX-License-Identifier: Apache-2.0

/*
 * The arithmetic of a filter step, compiled: functions of numpy_kernel.py, which describes them,
 * without the cost of numpy's calls on a few numbers.
 *
 * Small arrays may have any layout and any type of numbers; matrices of the size of the state are
 * Fortran arrays of double and changed in place. Arrays of other shapes raise. BLAS and LAPACK are
 * those of scipy, through the pointers that it offers to Cython.
 */

#define PY_SSIZE_T_CLEAN
#define NPY_NO_DEPRECATED_API NPY_1_22_API_VERSION
#include <Python.h>
#include <numpy/arrayobject.h>
#include <limits.h>
#include <math.h>
#include <string.h>

#if defined(__GNUC__) && defined(__x86_64__)
#include "_avx512.h"
#endif

/* Arguments and results of a call that are arrays, and arguments that are numbers. */
#define MAX_ARRAYS 10
#define MAX_NUMBERS 2
/* States of an observation: a pose and a position. */
#define POSE 3
#define STATES 5
/* Rows of a few columns that are computed together, so that the compiler uses vectors. */
#define CHUNK 64
/* Numbers in a line of the cache. */
#define LINE 8

typedef void blas_dgemm(
    char *, char *, int *, int *, int *, double *, double *, int *, double *, int *, double *,
    double *, int *);
typedef void blas_dgemv(
    char *, int *, int *, double *, double *, int *, double *, int *, double *, double *, int *);
typedef void blas_dsyrk(
    char *, char *, int *, int *, double *, double *, int *, double *, double *, int *);
typedef void blas_dtrsm(
    char *, char *, char *, char *, int *, int *, double *, double *, int *, double *, int *);
typedef void blas_dtrsv(char *, char *, char *, int *, double *, int *, double *, int *);
typedef void lapack_dpotrf(char *, int *, double *, int *, int *);

static blas_dgemm *dgemm;
static blas_dgemv *dgemv;
static blas_dsyrk *dsyrk;
static blas_dtrsm *dtrsm;
static blas_dtrsv *dtrsv;
static lapack_dpotrf *dpotrf;

static const double PI = 3.14159265358979323846;

/* Arrays of a call: those taken from its arguments, then those created as its results; numbers. */
typedef struct {
    PyArrayObject *array[MAX_ARRAYS];
    int count;
    int taken;
    Py_ssize_t number[MAX_NUMBERS];
} Arrays;

static PyObject *release(Arrays *a)
{
    while (a->count)
        Py_DECREF(a->array[--a->count]);
    return NULL;
}

/* Return a new reference to an object as an array of a type and flags, converted if needed. */
static PyObject *as_array(PyObject *object, int type, int flags)
{
    PyArrayObject *array = (PyArrayObject *)object;
    if (PyArray_Check(object) && PyArray_TYPE(array) == type && PyArray_ISNOTSWAPPED(array)
            && PyArray_CHKFLAGS(array, flags) && !(flags & NPY_ARRAY_ENSURECOPY))
        return Py_NewRef(object);
    return PyArray_FROM_OTF(object, type, flags);
}

/*
 * Take the arguments of the given kinds; return whether it succeeded, with no array held if not.
 * In C order: v, d and b of double with one, two and three axes; i of Py_ssize_t with one, I with
 * two. In Fortran order, two axes: f double; c a copy of that; m a matrix that is changed in
 * place, which is never converted. n is a number.
 */
static int take(Arrays *a, PyObject *const *arguments, Py_ssize_t given, const char *kinds)
{
    int numbers = 0;
    a->count = 0;
    if (given != (Py_ssize_t)strlen(kinds)) {
        PyErr_Format(PyExc_TypeError, "%zu arguments expected", strlen(kinds));
        return 0;
    }
    for (int i = 0; kinds[i]; i++) {
        if (kinds[i] == 'n') {
            a->number[numbers] = PyNumber_AsSsize_t(arguments[i], PyExc_OverflowError);
            if (a->number[numbers++] == -1 && PyErr_Occurred()) {
                release(a);
                return 0;
            }
            continue;
        }
        int type = kinds[i] == 'i' || kinds[i] == 'I' ? NPY_INTP : NPY_DOUBLE;
        int axes = kinds[i] == 'v' || kinds[i] == 'i' ? 1 : kinds[i] == 'b' ? 3 : 2;
        int flags = NPY_ARRAY_CARRAY_RO;
        if (kinds[i] == 'f')
            flags = NPY_ARRAY_FARRAY_RO;
        if (kinds[i] == 'm')
            flags = NPY_ARRAY_FARRAY;
        if (kinds[i] == 'c')
            flags = NPY_ARRAY_FARRAY | NPY_ARRAY_ENSURECOPY;
        PyObject *array = as_array(arguments[i], type, flags);
        if (!array) {
            release(a);
            return 0;
        }
        a->array[a->count++] = (PyArrayObject *)array;
        if (kinds[i] == 'm' && array != arguments[i]) {
            PyErr_Format(PyExc_TypeError, "argument %d is no Fortran array of double", i);
            release(a);
            return 0;
        }
        if (PyArray_NDIM((PyArrayObject *)array) != axes) {
            PyErr_Format(PyExc_ValueError, "argument %d must have %d axes", i, axes);
            release(a);
            return 0;
        }
    }
    a->taken = a->count;
    return 1;
}

/* Return whether the arguments fit each other, with no array held if not. */
static int fit(Arrays *a, int is_fitting)
{
    if (!is_fitting) {
        PyErr_SetString(PyExc_ValueError, "arrays of shapes that do not fit each other");
        release(a);
    }
    return is_fitting;
}

static double *data(const Arrays *a, int i)
{
    return (double *)PyArray_DATA(a->array[i]);
}

static Py_ssize_t length(const Arrays *a, int i, int axis)
{
    return PyArray_DIM(a->array[i], axis);
}

static int is_vector(const Arrays *a, int i, Py_ssize_t n)
{
    return length(a, i, 0) == n;
}

static int is_matrix(const Arrays *a, int i, Py_ssize_t m, Py_ssize_t n)
{
    return length(a, i, 0) == m && length(a, i, 1) == n;
}

static int are_blocks(const Arrays *a, int i, Py_ssize_t l, Py_ssize_t m, Py_ssize_t n)
{
    return is_matrix(a, i, l, m) && length(a, i, 2) == n;
}

/* Whether all elements of an array of Py_ssize_t are indices of a vector of n. */
static int are_indices(const Arrays *a, int i, Py_ssize_t n)
{
    const Py_ssize_t *index = PyArray_DATA(a->array[i]), count = PyArray_SIZE(a->array[i]);
    for (Py_ssize_t k = 0; k < count; k++)
        if (index[k] < 0 || index[k] >= n)
            return 0;
    return 1;
}

/* Create a result of up to three axes; return its elements, which are to be set, or NULL. */
static double *create(Arrays *a, int axes, const npy_intp *shape, int is_fortran)
{
    PyObject *array = PyArray_EMPTY(axes, shape, NPY_DOUBLE, is_fortran);
    if (!array)
        return NULL;
    a->array[a->count++] = (PyArrayObject *)array;
    return data(a, a->count - 1);
}

static double *vector(Arrays *a, npy_intp n)
{
    return create(a, 1, &n, 0);
}

static double *matrix(Arrays *a, npy_intp m, npy_intp n, int is_fortran)
{
    npy_intp shape[] = {m, n};
    return create(a, 2, shape, is_fortran);
}

static double *blocks(Arrays *a, npy_intp l, npy_intp m, npy_intp n)
{
    npy_intp shape[] = {l, m, n};
    return create(a, 3, shape, 0);
}

/* Return the results, a tuple if there are several, and release the arguments. */
static PyObject *results(Arrays *a)
{
    int count = a->count - a->taken;
    PyObject *returned = count == 1 ? Py_NewRef(a->array[a->taken]) : PyTuple_New(count);
    for (int i = 0; returned && count > 1 && i < count; i++)
        PyTuple_SET_ITEM(returned, i, Py_NewRef(a->array[a->taken + i]));
    release(a);
    return returned;
}

static double wrap(double angle)
{
    if (-PI < angle && angle <= PI)
        return angle;
    return angle - 2.0 * PI * ceil((angle - PI) / (2.0 * PI));
}

/* moved(x, u, Q): x_pred, N */
static PyObject *moved(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    Arrays a;
    if (!take(&a, arguments, given, "vvd")
            || !fit(&a, is_vector(&a, 0, POSE) && is_vector(&a, 1, POSE)
                        && is_matrix(&a, 2, POSE, POSE)))
        return NULL;
    const double *x = data(&a, 0), *u = data(&a, 1), *Q = data(&a, 2);
    double *x_pred = vector(&a, 3), *N = matrix(&a, 3, 3, 0);
    double c = cos(x[2]), s = sin(x[2]), GQ[9];
    if (!x_pred || !N)
        return release(&a);

    x_pred[0] = x[0] + c * u[0] - s * u[1];
    x_pred[1] = x[1] + s * u[0] + c * u[1];
    x_pred[2] = wrap(x[2] + u[2]);
    for (int j = 0; j < 3; j++) {
        GQ[j] = c * Q[j] - s * Q[3 + j];
        GQ[3 + j] = s * Q[j] + c * Q[3 + j];
        GQ[6 + j] = Q[6 + j];
    }
    for (int i = 0; i < 3; i++) {
        N[3 * i] = c * GQ[3 * i] - s * GQ[3 * i + 1];
        N[3 * i + 1] = s * GQ[3 * i] + c * GQ[3 * i + 1];
        N[3 * i + 2] = GQ[3 * i + 2];
    }
    return results(&a);
}

/* Phi(x, x_next): eq. (5) */
static PyObject *Phi(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    Arrays a;
    if (!take(&a, arguments, given, "vv")
            || !fit(&a, is_vector(&a, 0, POSE) && is_vector(&a, 1, POSE)))
        return NULL;
    const double *x = data(&a, 0), *x_next = data(&a, 1);
    double *transition = matrix(&a, 3, 3, 0);
    if (!transition)
        return release(&a);

    const double values[] = {
        1.0, 0.0, x[1] - x_next[1], 0.0, 1.0, x_next[0] - x[0], 0.0, 0.0, 1.0};
    memcpy(transition, values, sizeof values);
    return results(&a);
}

/* C = A B of (d, d) arrays in C order. */
static void multiply(Py_ssize_t d, const double *A, const double *B, double *C)
{
    for (Py_ssize_t i = 0; i < d; i++)
        for (Py_ssize_t j = 0; j < d; j++) {
            double sum = 0.0;
            for (Py_ssize_t k = 0; k < d; k++)
                sum += A[i * d + k] * B[k * d + j];
            C[i * d + j] = sum;
        }
}

/* propagated(before, block, Phi, N): transition, block; d is 2 or 3 */
static PyObject *propagated(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    Arrays a;
    int is_first = given > 0 && arguments[0] == Py_None;
    if (!take(&a, arguments + is_first, given - is_first, is_first ? "ddd" : "dddd"))
        return NULL;
    Py_ssize_t d = length(&a, 0, 0);
    int block = a.taken - 3, is_fitting = d <= POSE;
    for (int i = 0; i < a.taken; i++)
        is_fitting = is_fitting && is_matrix(&a, i, d, d);
    if (!fit(&a, is_fitting))
        return NULL;
    const double *Phi = data(&a, block + 1), *N = data(&a, block + 2);
    double *transition = matrix(&a, d, d, 0), *result = matrix(&a, d, d, 0);
    double left[POSE * POSE], P[POSE * POSE], Phi_T[POSE * POSE];
    if (!transition || !result)
        return release(&a);

    if (is_first)
        memcpy(transition, Phi, d * d * sizeof(double));
    else
        multiply(d, Phi, data(&a, 0), transition);
    for (Py_ssize_t i = 0; i < d; i++)
        for (Py_ssize_t j = 0; j < d; j++)
            Phi_T[j * d + i] = Phi[i * d + j];
    multiply(d, Phi, data(&a, block), left);
    multiply(d, left, Phi_T, P);
    for (Py_ssize_t i = 0; i < d; i++)
        for (Py_ssize_t j = 0; j < d; j++)
            result[i * d + j] = 0.5 * (
                P[i * d + j] + N[i * d + j] + (P[j * d + i] + N[j * d + i]));
    return results(&a);
}

/* diagonal_block(lower, start, size) */
static PyObject *diagonal_block(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    Arrays a;
    if (!take(&a, arguments, given, "mnn"))
        return NULL;
    Py_ssize_t capacity = length(&a, 0, 0), start = a.number[0], size = a.number[1];
    if (!fit(&a, is_matrix(&a, 0, capacity, capacity) && start >= 0 && size >= 0
                 && start <= capacity - size))
        return NULL;
    const double *first = data(&a, 0) + start * capacity + start;
    double *block = matrix(&a, size, size, 0);
    if (!block)
        return release(&a);

    for (Py_ssize_t j = 0; j < size; j++)
        for (Py_ssize_t i = j; i < size; i++)
            block[i * size + j] = block[j * size + i] = first[j * capacity + i];
    return results(&a);
}

/* settle(lower, n, start, Phi, block) */
static PyObject *settle(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    Arrays a;
    if (!take(&a, arguments, given, "mnndd"))
        return NULL;
    double *lower = data(&a, 0), mixed[POSE];
    const double *Phi = data(&a, 1), *block = data(&a, 2);
    Py_ssize_t capacity = length(&a, 0, 0), d = length(&a, 1, 0);
    Py_ssize_t n = a.number[0], start = a.number[1];
    if (!fit(&a, is_matrix(&a, 0, capacity, capacity) && d <= POSE && is_matrix(&a, 1, d, d)
                 && is_matrix(&a, 2, d, d) && start >= 0 && start <= n - d && n <= capacity))
        return NULL;

    for (Py_ssize_t j = 0; j < start; j++) {
        double *row = lower + j * capacity + start;
        for (Py_ssize_t i = 0; i < d; i++) {
            mixed[i] = 0.0;
            for (Py_ssize_t k = 0; k < d; k++)
                mixed[i] += Phi[i * d + k] * row[k];
        }
        memcpy(row, mixed, d * sizeof(double));
    }
    for (Py_ssize_t i = start + d; i < n; i += CHUNK) {
        double *columns = lower + start * capacity + i, chunk[POSE][CHUNK] = {{0.0}};
        Py_ssize_t count = n - i < CHUNK ? n - i : CHUNK;
        for (Py_ssize_t j = 0; j < d; j++)
            for (Py_ssize_t k = 0; k < d; k++)
                for (Py_ssize_t l = 0; l < count; l++)
                    chunk[j][l] += Phi[j * d + k] * columns[k * capacity + l];
        for (Py_ssize_t j = 0; j < d; j++)
            memcpy(columns + j * capacity, chunk[j], count * sizeof(double));
    }
    for (Py_ssize_t i = 0; i < d; i++)
        for (Py_ssize_t j = 0; j < d; j++)
            lower[(start + j) * capacity + start + i] = block[i * d + j];
    release(&a);
    Py_RETURN_NONE;
}

/* Copy an array of `size` numbers. */
static void copy_numbers(PyObject *object, Py_ssize_t size, double *numbers)
{
    PyObject *array = as_array(object, NPY_DOUBLE, NPY_ARRAY_CARRAY_RO);
    if (array && PyArray_SIZE((PyArrayObject *)array) != size)
        PyErr_Format(PyExc_ValueError, "arrays of %zd numbers expected", size);
    else if (array)
        memcpy(numbers, PyArray_DATA((PyArrayObject *)array), size * sizeof(double));
    Py_XDECREF(array);
}

/* Set the states of a variable of a size from its first one. */
static void set_states(PyObject *first, Py_ssize_t size, Py_ssize_t *states)
{
    Py_ssize_t start = PyNumber_AsSsize_t(first, PyExc_OverflowError);
    if (!PyErr_Occurred() && (start < 0 || start > PY_SSIZE_T_MAX - size))
        PyErr_SetString(PyExc_ValueError, "no index of a state");
    for (Py_ssize_t k = 0; k < size && !PyErr_Occurred(); k++)
        states[k] = start + k;
}

/* stacked(observers, observed, z, R): states, z, R */
static PyObject *stacked(PyObject *module, PyObject *const *lists, Py_ssize_t given)
{
    /* Tuples, since converting an element may run code that changes the lists. */
    PyObject *tuples = PyTuple_New(4), *columns[4] = {NULL};
    for (Py_ssize_t i = 0; tuples && i < 4 && !PyErr_Occurred(); i++) {
        columns[i] = given == 4 && PyList_Check(lists[i]) ? PyList_AsTuple(lists[i]) : NULL;
        if (columns[i])
            PyTuple_SET_ITEM(tuples, i, columns[i]);
        if (!PyErr_Occurred() && (!columns[i]
                || PyTuple_GET_SIZE(columns[i]) != PyTuple_GET_SIZE(columns[0])))
            PyErr_SetString(PyExc_TypeError, "four lists of equal length expected");
    }
    if (PyErr_Occurred()) {
        Py_XDECREF(tuples);
        return NULL;
    }
    Arrays a = {.count = 0, .taken = 0};
    npy_intp m = PyTuple_GET_SIZE(columns[0]), shape[] = {m, STATES};
    PyObject *states = PyArray_EMPTY(2, shape, NPY_INTP, 0);
    double *z = matrix(&a, m, 2, 0), *R = blocks(&a, m, 2, 2);

    for (Py_ssize_t i = 0; i < m && !PyErr_Occurred(); i++) {
        Py_ssize_t *state = (Py_ssize_t *)PyArray_DATA((PyArrayObject *)states) + STATES * i;
        set_states(PyTuple_GET_ITEM(columns[0], i), POSE, state);
        if (!PyErr_Occurred())
            set_states(PyTuple_GET_ITEM(columns[1], i), STATES - POSE, state + POSE);
        if (!PyErr_Occurred())
            copy_numbers(PyTuple_GET_ITEM(columns[2], i), 2, z + 2 * i);
        if (!PyErr_Occurred())
            copy_numbers(PyTuple_GET_ITEM(columns[3], i), 4, R + 4 * i);
    }
    PyObject *returned = PyErr_Occurred() ? NULL : Py_BuildValue(
        "OOO", states, a.array[0], a.array[1]);
    Py_XDECREF(states);
    Py_DECREF(tuples);
    release(&a);
    return returned;
}

/* h(x), eq. (7), of poses and points in one array */
static PyObject *h(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    Arrays a;
    Py_ssize_t m = take(&a, arguments, given, "d") ? length(&a, 0, 0) : -1;
    if (m < 0 || !fit(&a, is_matrix(&a, 0, m, STATES)))
        return NULL;
    double *z = matrix(&a, m, 2, 0);
    if (!z)
        return release(&a);

    for (Py_ssize_t i = 0; i < m; i++) {
        const double *x = data(&a, 0) + STATES * i;
        double c = cos(x[2]), s = sin(x[2]), dx = x[3] - x[0], dy = x[4] - x[1];
        z[2 * i] = c * dx + s * dy;
        z[2 * i + 1] = c * dy - s * dx;
    }
    return results(&a);
}

/* H(x), eqs. (10) and (11), likewise */
static PyObject *H(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    Arrays a;
    Py_ssize_t m = take(&a, arguments, given, "d") ? length(&a, 0, 0) : -1;
    if (m < 0 || !fit(&a, is_matrix(&a, 0, m, STATES)))
        return NULL;
    double *block = blocks(&a, m, 2, STATES);
    if (!block)
        return release(&a);

    for (Py_ssize_t i = 0; i < m; i++, block += 2 * STATES) {
        const double *x = data(&a, 0) + STATES * i;
        double c = cos(x[2]), s = sin(x[2]), dx = x[3] - x[0], dy = x[4] - x[1];
        const double values[] = {
            -c, -s, c * dy - s * dx, c, s,
            s, -c, -c * dx - s * dy, -s, c};
        memcpy(block, values, sizeof values);
    }
    return results(&a);
}

/* Copy full columns `states` of a symmetric matrix from its lower triangle, of `rows` rows each. */
static void copy_columns(
    const double *lower, Py_ssize_t capacity, Py_ssize_t rows, const Py_ssize_t *states,
    Py_ssize_t k, double *columns)
{
    /* The parts above the diagonal lie across the columns of the triangle: by lines of the cache. */
    for (Py_ssize_t line = 0; line < rows; line += LINE)
        for (Py_ssize_t c = 0; c < k; c++) {
            Py_ssize_t j = states[c], stop = j < line + LINE ? j : line + LINE;
            for (Py_ssize_t i = line; i < stop; i++)
                columns[c * rows + i] = lower[i * capacity + j];
        }
    for (Py_ssize_t c = 0; c < k; c++) {
        Py_ssize_t j = states[c];
        memcpy(columns + c * rows + j, lower + j * capacity + j, (rows - j) * sizeof(double));
    }
}

/* columns(lower, indices) */
static PyObject *columns(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    Arrays a;
    if (!take(&a, arguments, given, "mi"))
        return NULL;
    Py_ssize_t capacity = length(&a, 0, 0), k = length(&a, 1, 0);
    if (!fit(&a, is_matrix(&a, 0, capacity, capacity) && are_indices(&a, 1, capacity)))
        return NULL;
    double *full = matrix(&a, capacity, k, 1);
    if (!full)
        return release(&a);
    copy_columns(data(&a, 0), capacity, capacity, PyArray_DATA(a.array[1]), k, full);
    return results(&a);
}

/* replace_columns(lower, indices, full) */
static PyObject *replace_columns(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    Arrays a;
    if (!take(&a, arguments, given, "mif"))
        return NULL;
    Py_ssize_t capacity = length(&a, 0, 0), k = length(&a, 1, 0);
    if (!fit(&a, is_matrix(&a, 0, capacity, capacity) && are_indices(&a, 1, capacity)
                 && is_matrix(&a, 2, capacity, k)))
        return NULL;
    double *lower = data(&a, 0), *full = data(&a, 2);
    const Py_ssize_t *indices = PyArray_DATA(a.array[1]);

    for (Py_ssize_t c = 0; c < k; c++) {
        Py_ssize_t j = indices[c], diagonal = j * capacity + j;
        memcpy(lower + diagonal, full + c * capacity + j, (capacity - j) * sizeof(double));
    }
    /* The parts above the diagonal, as in copy_columns. */
    for (Py_ssize_t line = 0; line < capacity; line += LINE)
        for (Py_ssize_t c = 0; c < k; c++) {
            Py_ssize_t j = indices[c], stop = j < line + LINE ? j : line + LINE;
            for (Py_ssize_t i = line; i < stop; i++)
                lower[i * capacity + j] = full[c * capacity + i];
        }
    release(&a);
    Py_RETURN_NONE;
}

/*
 * Number the states in `observed` in ascending order; return how many there are. `states` and
 * `column_of`, which is zero at the start, have room for n.
 */
static Py_ssize_t touched(
    const Py_ssize_t *observed, Py_ssize_t count, Py_ssize_t n, Py_ssize_t *states,
    Py_ssize_t *column_of)
{
    Py_ssize_t k = 0;
    for (Py_ssize_t i = 0; i < count; i++)
        column_of[observed[i]] = 1;
    for (Py_ssize_t state = 0; state < n; state++)
        if (column_of[state]) {
            column_of[state] = k;
            states[k++] = state;
        }
    return k;
}

/* project(lower, n, observed, blocks, R): P, H, S, own */
static PyObject *project(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    Arrays a;
    if (!take(&a, arguments, given, "mnIbb"))
        return NULL;
    const double *lower = data(&a, 0), *jacobian = data(&a, 2), *R = data(&a, 3);
    const Py_ssize_t *observed = PyArray_DATA(a.array[1]);
    Py_ssize_t capacity = length(&a, 0, 0), m = length(&a, 1, 0), d = length(&a, 1, 1);
    Py_ssize_t n = a.number[0], rows = 2 * m;
    if (!fit(&a, is_matrix(&a, 0, capacity, capacity) && n >= 0 && n <= capacity
                 && are_indices(&a, 1, n) && are_blocks(&a, 2, m, 2, d)
                 && are_blocks(&a, 3, m, 2, 2)))
        return NULL;
    Py_ssize_t *column_of = PyMem_Calloc(2 * n + 1, sizeof *column_of), *states = column_of + n;
    if (!column_of) {
        release(&a);
        return PyErr_NoMemory();
    }
    Py_ssize_t k = touched(observed, m * d, n, states, column_of);
    double *P = matrix(&a, n, k, 1), *H = matrix(&a, rows, k, 1);
    double *S = matrix(&a, rows, rows, 0), *own = blocks(&a, m, 2, 2);
    if (!P || !H || !S || !own) {
        PyMem_Free(column_of);
        return release(&a);
    }

    copy_columns(lower, capacity, n, states, k, P);
    memset(H, 0, rows * k * sizeof(double));
    for (Py_ssize_t i = 0; i < rows; i++)
        for (Py_ssize_t j = 0; j < d; j++)
            /* A state may be listed twice in a row; its entries are added. */
            H[column_of[observed[i / 2 * d + j]] * rows + i] += jacobian[i * d + j];
    /* S = (H P) H^T by blocks of two observations, each row of H having d nonzeros. */
    for (Py_ssize_t i = 0; i < m; i++)
        for (Py_ssize_t l = 0; l <= i; l++) {
            const Py_ssize_t *of_i = observed + i * d, *of_l = observed + l * d;
            const double *H_i = jacobian + 2 * i * d, *H_l = jacobian + 2 * l * d;
            double block[2][2] = {{0.0}};
            for (Py_ssize_t j = 0; j < d; j++) {
                const double *column = P + column_of[of_l[j]] * n;
                double HP[2] = {0.0};
                for (Py_ssize_t e = 0; e < d; e++) {
                    HP[0] += H_i[e] * column[of_i[e]];
                    HP[1] += H_i[d + e] * column[of_i[e]];
                }
                for (int row = 0; row < 2; row++) {
                    block[row][0] += HP[row] * H_l[j];
                    block[row][1] += HP[row] * H_l[d + j];
                }
            }
            if (l == i) {
                block[0][1] = block[1][0];
                for (int e = 0; e < 4; e++)
                    own[4 * i + e] = block[e / 2][e % 2] += R[4 * i + e];
            }
            for (int row = 0; row < 2; row++)
                for (int e = 0; e < 2; e++)
                    S[(2 * i + row) * rows + 2 * l + e] = S[(2 * l + e) * rows + 2 * i + row] =
                        block[row][e];
        }
    PyMem_Free(column_of);
    return results(&a);
}

/* squared_distances(r, S) */
static PyObject *squared_distances(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    Arrays a;
    Py_ssize_t m = take(&a, arguments, given, "db") ? length(&a, 0, 0) : -1;
    if (m < 0 || !fit(&a, is_matrix(&a, 0, m, 2) && are_blocks(&a, 1, m, 2, 2)))
        return NULL;
    double *d2 = vector(&a, m);
    if (!d2)
        return release(&a);

    for (Py_ssize_t i = 0; i < m; i++) {
        const double *S = data(&a, 1) + 4 * i;
        double x = data(&a, 0)[2 * i], y = data(&a, 0)[2 * i + 1];
        double xx = S[0], xy = S[2], yy = S[3];
        d2[i] = (yy * x * x - 2.0 * xy * x * y + xx * y * y) / (xx * yy - xy * xy);
    }
    return results(&a);
}

static int has_avx512(void)
{
#ifdef AVX512
    return __builtin_cpu_supports("avx512f");
#else
    return 0;
#endif
}

/*
 * C -= A B^T of A (m, k) and B (n, k), all in Fortran order with these strides; if A is B, for the
 * lower triangle of C.
 */
static void subtract(
    int m, int n, int k, double *A, int A_stride, double *B, int B_stride, double *C, int C_stride)
{
    double one = 1.0, minus = -1.0;
#ifdef AVX512
    if (has_avx512()) {
        subtract_by_tiles(m, n, k, A, A_stride, B, B_stride, C, C_stride);
        return;
    }
#endif
    if (A == B)
        dsyrk("L", "N", &n, &k, &minus, A, &A_stride, &one, C, &C_stride);
    else
        dgemm("N", "T", &m, &n, &k, &minus, A, &A_stride, B, &B_stride, &one, C, &C_stride);
}

/* correction(P, H, S, r, n): dx, y, W, log det S */
static PyObject *correction(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    Arrays a;
    if (!take(&a, arguments, given, "fccvn"))
        return NULL;
    double *P = data(&a, 0), *H = data(&a, 1), *L = data(&a, 2), one = 1.0, zero = 0.0;
    double minus = -1.0;
    int stored = (int)length(&a, 0, 0), k = (int)length(&a, 0, 1), step = 1, failed_at = 0;
    int rows = (int)length(&a, 3, 0), n = (int)a.number[0];
    if (!fit(&a, is_matrix(&a, 1, rows, k) && is_matrix(&a, 2, rows, rows)
                 && a.number[0] >= 0 && a.number[0] <= stored))
        return NULL;
    double *dx = vector(&a, n), *y = vector(&a, rows), *W = matrix(&a, n, rows, 1);
    double log_det = 0.0;
    if (!dx || !y || !W)
        return release(&a);
    memcpy(y, data(&a, 3), rows * sizeof(double));

    Py_BEGIN_ALLOW_THREADS
    dpotrf("L", &rows, L, &rows, &failed_at);
    if (!failed_at) {
        dtrsm("L", "L", "N", "N", &rows, &k, &minus, L, &rows, H, &rows);
        memset(W, 0, (size_t)n * rows * sizeof(double));
        subtract(n, rows, k, P, stored, H, rows, W, n);
        dtrsv("L", "N", "N", &rows, L, &rows, y, &step);
        dgemv("N", &n, &rows, &one, W, &n, y, &step, &zero, dx, &step);
        for (int i = 0; i < rows; i++)
            log_det += 2.0 * log(L[i * rows + i]);
    }
    Py_END_ALLOW_THREADS
    if (failed_at) {
        release(&a);
        return PyErr_Format(
            PyExc_ArithmeticError, "innovation covariance not positive definite at %d", failed_at);
    }
    PyArrayObject **first = a.array + a.taken;
    PyObject *returned = Py_BuildValue("OOOd", first[0], first[1], first[2], log_det);
    release(&a);
    return returned;
}

/* product(A, B): A B in C order, which is the product of B^T and A^T in Fortran order */
static PyObject *product(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    Arrays a;
    if (!take(&a, arguments, given, "cd"))
        return NULL;
    double *A = data(&a, 0), *B = data(&a, 1);
    Py_ssize_t m = length(&a, 0, 0), k = length(&a, 0, 1), n = length(&a, 1, 1);
    if (!fit(&a, length(&a, 1, 0) == k && m <= INT_MAX && k <= INT_MAX && n <= INT_MAX))
        return NULL;
    double *C = matrix(&a, m, n, 0);
    if (!C)
        return release(&a);

    Py_BEGIN_ALLOW_THREADS
    for (Py_ssize_t i = 0; i < m * k; i++)
        A[i] = -A[i];
    memset(C, 0, m * n * sizeof *C);
    if (m && n && k)  /* BLAS refuses strides of 0 */
        subtract((int)n, (int)m, (int)k, B, (int)n, A, (int)m, C, (int)n);
    Py_END_ALLOW_THREADS
    return results(&a);
}

/* subtract_product(lower, W, n) */
static PyObject *subtract_product(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    Arrays a;
    if (!take(&a, arguments, given, "mfn"))
        return NULL;
    double *lower = data(&a, 0), *W = data(&a, 1);
    int capacity = (int)length(&a, 0, 0), stored = (int)length(&a, 1, 0);
    int k = (int)length(&a, 1, 1), n = (int)a.number[0];
    if (!fit(&a, is_matrix(&a, 0, capacity, capacity) && a.number[0] >= 0
                 && a.number[0] <= capacity && a.number[0] <= stored))
        return NULL;

    Py_BEGIN_ALLOW_THREADS
    subtract(n, n, k, W, stored, W, stored, lower, capacity);
    Py_END_ALLOW_THREADS
    release(&a);
    Py_RETURN_NONE;
}

/* retracted(x, dx, headings) */
static PyObject *retracted(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    Arrays a;
    if (!take(&a, arguments, given, "vvi"))
        return NULL;
    const Py_ssize_t *headings = PyArray_DATA(a.array[2]);
    Py_ssize_t n = length(&a, 0, 0);
    if (!fit(&a, is_vector(&a, 1, n) && are_indices(&a, 2, n)))
        return NULL;
    double *corrected = vector(&a, n);
    if (!corrected)
        return release(&a);

    for (Py_ssize_t i = 0; i < n; i++)
        corrected[i] = data(&a, 0)[i] + data(&a, 1)[i];
    for (Py_ssize_t i = 0; i < length(&a, 2, 0); i++)
        corrected[headings[i]] = wrap(corrected[headings[i]]);
    return results(&a);
}

/* Set a pointer to a routine of scipy.linalg.cython_blas or cython_lapack. */
static int find(const char *module, const char *routine, void **pointer)
{
    PyObject *imported = PyImport_ImportModule(module);
    PyObject *offered = imported ? PyObject_GetAttrString(imported, "__pyx_capi__") : NULL;
    PyObject *capsule = offered ? PyMapping_GetItemString(offered, routine) : NULL;
    *pointer = capsule ? PyCapsule_GetPointer(capsule, PyCapsule_GetName(capsule)) : NULL;
    Py_XDECREF(capsule);
    Py_XDECREF(offered);
    Py_XDECREF(imported);
    return *pointer != NULL;
}

#define FUNCTION(name) {#name, (PyCFunction)(void (*)(void))name, METH_FASTCALL, NULL}

static PyMethodDef functions[] = {
    FUNCTION(moved), FUNCTION(Phi), FUNCTION(propagated), FUNCTION(diagonal_block),
    FUNCTION(settle), FUNCTION(stacked), FUNCTION(h), FUNCTION(H), FUNCTION(columns),
    FUNCTION(replace_columns), FUNCTION(project), FUNCTION(squared_distances),
    FUNCTION(correction), FUNCTION(product), FUNCTION(subtract_product), FUNCTION(retracted),
    {NULL, NULL, 0, NULL}};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "_kernel", NULL, -1, functions, NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__kernel(void)
{
    const char *blas = "scipy.linalg.cython_blas", *lapack = "scipy.linalg.cython_lapack";
    import_array();
    if (!find(blas, "dgemm", (void **)&dgemm) || !find(blas, "dgemv", (void **)&dgemv)
            || !find(blas, "dsyrk", (void **)&dsyrk)
            || !find(blas, "dtrsm", (void **)&dtrsm)
            || !find(blas, "dtrsv", (void **)&dtrsv)
            || !find(lapack, "dpotrf", (void **)&dpotrf))
        return NULL;
    PyObject *module = PyModule_Create(&definition);
    if (module && PyModule_AddStringConstant(
            module, "PRODUCTS", has_avx512() ? "AVX-512" : "BLAS"))
        Py_CLEAR(module);
    return module;
}
