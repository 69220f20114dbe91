// SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
// SPDX-License-Identifier: Apache-2.0

/*
 * The arithmetic of a filter step, compiled: what numpy_kernel.py computes, in the same order of
 * arguments, without the cost of a numpy call for each operation on a few numbers.
 *
 * compiled_kernel.py allocates the results and passes them after the inputs. All arrays are of
 * double or of Py_ssize_t; inputs may have any strides, but matrices of the size of the state and
 * all results are contiguous, in Fortran order where numpy_kernel.py says so. BLAS and LAPACK are
 * those of scipy, through the pointers that it offers to Cython.
 */

#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#define MAX_ARRAYS 10
#define NATIVE (PY_LITTLE_ENDIAN ? "@=<" : "@=>")

static const double PI = 3.14159265358979323846;

/* Elements of an array of double (or of indices) given as a Py_buffer. */
#define AT1(a, i) (*(double *)((char *)(a).buf + (i) * (a).strides[0]))
#define AT2(a, i, j) (*(double *)((char *)(a).buf + (i) * (a).strides[0] + (j) * (a).strides[1]))
#define AT3(a, i, j, k) (*(double *)( \
    (char *)(a).buf + (i) * (a).strides[0] + (j) * (a).strides[1] + (k) * (a).strides[2]))
#define INDEX1(a, i) (*(Py_ssize_t *)((char *)(a).buf + (i) * (a).strides[0]))
#define INDEX2(a, i, j) (*(Py_ssize_t *)( \
    (char *)(a).buf + (i) * (a).strides[0] + (j) * (a).strides[1]))

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

/* Arrays of the arguments of a call; they are released together. */
typedef struct {
    Py_buffer array[MAX_ARRAYS];
    int count;
} Arrays;

static void release(Arrays *a)
{
    while (a->count)
        PyBuffer_Release(&a->array[--a->count]);
}

/*
 * Take the first arguments as arrays, the others are numbers; return whether it succeeded. There is
 * a letter for each array: d of double, i of Py_ssize_t.
 */
static int take(
    Arrays *a, PyObject *const *arguments, Py_ssize_t given, const char *kinds, int numbers)
{
    a->count = 0;
    if (given != (Py_ssize_t)strlen(kinds) + numbers) {
        PyErr_Format(PyExc_TypeError, "%zu arguments expected", strlen(kinds) + numbers);
        return 0;
    }
    for (; kinds[a->count]; a->count++) {
        Py_buffer *array = &a->array[a->count];
        if (PyObject_GetBuffer(arguments[a->count], array, PyBUF_STRIDED_RO | PyBUF_FORMAT)) {
            release(a);
            return 0;
        }
        /* A prefix names the byte order. */
        const char *type = array->format + (strchr(NATIVE, array->format[0]) != NULL);
        int is_double = strcmp(type, "d") == 0;
        if (array->itemsize != 8 || is_double != (kinds[a->count] == 'd')) {
            PyErr_Format(
                PyExc_TypeError, "argument %d has elements of type %s", a->count, array->format);
            a->count++;
            release(a);
            return 0;
        }
    }
    return 1;
}

static double wrap(double angle)
{
    if (-PI < angle && angle <= PI)
        return angle;
    return angle - 2.0 * PI * ceil((angle - PI) / (2.0 * PI));
}

/* moved(x, u, Q, x_pred, N): x_pred = f(x, u), N = G Q G^T. */
static PyObject *moved(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    Arrays a;
    if (!take(&a, arguments, given, "ddddd", 0))
        return NULL;
    Py_buffer x = a.array[0], u = a.array[1], Q = a.array[2];
    double *x_pred = a.array[3].buf, *N = a.array[4].buf;
    double phi = AT1(x, 2), c = cos(phi), s = sin(phi), GQ[9];

    x_pred[0] = AT1(x, 0) + c * AT1(u, 0) - s * AT1(u, 1);
    x_pred[1] = AT1(x, 1) + s * AT1(u, 0) + c * AT1(u, 1);
    x_pred[2] = wrap(phi + AT1(u, 2));
    for (int j = 0; j < 3; j++) {
        GQ[j] = c * AT2(Q, 0, j) - s * AT2(Q, 1, j);
        GQ[3 + j] = s * AT2(Q, 0, j) + c * AT2(Q, 1, j);
        GQ[6 + j] = AT2(Q, 2, j);
    }
    for (int i = 0; i < 3; i++) {
        N[3 * i] = c * GQ[3 * i] - s * GQ[3 * i + 1];
        N[3 * i + 1] = s * GQ[3 * i] + c * GQ[3 * i + 1];
        N[3 * i + 2] = GQ[3 * i + 2];
    }
    release(&a);
    Py_RETURN_NONE;
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

/* propagated(before, block, Phi, N, transition, result), each (3, 3) at most and in C order. */
static PyObject *propagated(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    Arrays a;
    if (!take(&a, arguments, given, "dddddd", 0))
        return NULL;
    Py_ssize_t d = a.array[0].shape[0];
    const double *Phi = a.array[2].buf, *N = a.array[3].buf;
    double *result = a.array[5].buf, left[9], P[9], Phi_T[9];

    multiply(d, Phi, a.array[0].buf, a.array[4].buf);
    for (Py_ssize_t i = 0; i < d; i++)
        for (Py_ssize_t j = 0; j < d; j++)
            Phi_T[j * d + i] = Phi[i * d + j];
    multiply(d, Phi, a.array[1].buf, left);
    multiply(d, left, Phi_T, P);
    for (Py_ssize_t i = 0; i < d; i++)
        for (Py_ssize_t j = 0; j < d; j++)
            result[i * d + j] = 0.5 * (
                P[i * d + j] + N[i * d + j] + (P[j * d + i] + N[j * d + i]));
    release(&a);
    Py_RETURN_NONE;
}

/* settle(lower, Phi, block, n, start) */
static PyObject *settle(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    Arrays a;
    if (!take(&a, arguments, given, "ddd", 2))
        return NULL;
    double *lower = a.array[0].buf, mixed[3];
    const double *Phi = a.array[1].buf, *block = a.array[2].buf;
    Py_ssize_t capacity = a.array[0].shape[0], d = a.array[1].shape[0];
    Py_ssize_t n = PyLong_AsSsize_t(arguments[3]), start = PyLong_AsSsize_t(arguments[4]);

    for (Py_ssize_t j = 0; j < start; j++) {
        double *row = lower + j * capacity + start;
        for (Py_ssize_t i = 0; i < d; i++) {
            mixed[i] = 0.0;
            for (Py_ssize_t k = 0; k < d; k++)
                mixed[i] += Phi[i * d + k] * row[k];
        }
        memcpy(row, mixed, d * sizeof(double));
    }
    for (Py_ssize_t i = start + d; i < n; i++) {
        double *column = lower + start * capacity + i;
        for (Py_ssize_t j = 0; j < d; j++) {
            mixed[j] = 0.0;
            for (Py_ssize_t k = 0; k < d; k++)
                mixed[j] += Phi[j * d + k] * column[k * capacity];
        }
        for (Py_ssize_t j = 0; j < d; j++)
            column[j * capacity] = mixed[j];
    }
    for (Py_ssize_t i = 0; i < d; i++)
        for (Py_ssize_t j = 0; j < d; j++)
            lower[(start + j) * capacity + start + i] = block[i * d + j];
    release(&a);
    Py_RETURN_NONE;
}

/* h(poses, points, z), eq. (7). */
static PyObject *h(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    Arrays a;
    if (!take(&a, arguments, given, "ddd", 0))
        return NULL;
    Py_buffer poses = a.array[0], points = a.array[1];
    double *z = a.array[2].buf;

    for (Py_ssize_t i = 0; i < poses.shape[0]; i++) {
        double c = cos(AT2(poses, i, 2)), s = sin(AT2(poses, i, 2));
        double dx = AT2(points, i, 0) - AT2(poses, i, 0);
        double dy = AT2(points, i, 1) - AT2(poses, i, 1);
        z[2 * i] = c * dx + s * dy;
        z[2 * i + 1] = c * dy - s * dx;
    }
    release(&a);
    Py_RETURN_NONE;
}

/* H(poses, points, blocks), eqs. (10) and (11). */
static PyObject *H(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    Arrays a;
    if (!take(&a, arguments, given, "ddd", 0))
        return NULL;
    Py_buffer poses = a.array[0], points = a.array[1];

    for (Py_ssize_t i = 0; i < poses.shape[0]; i++) {
        double *block = (double *)a.array[2].buf + 10 * i;
        double c = cos(AT2(poses, i, 2)), s = sin(AT2(poses, i, 2));
        double dx = AT2(points, i, 0) - AT2(poses, i, 0);
        double dy = AT2(points, i, 1) - AT2(poses, i, 1);
        double by_x[5] = {-c, -s, c * dy - s * dx, c, s};
        double by_y[5] = {s, -c, -c * dx - s * dy, -s, c};
        memcpy(block, by_x, sizeof by_x);
        memcpy(block + 5, by_y, sizeof by_y);
    }
    release(&a);
    Py_RETURN_NONE;
}

/* observed_states(starts, columns) */
static PyObject *observed_states(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    Arrays a;
    if (!take(&a, arguments, given, "ii", 0))
        return NULL;
    const Py_ssize_t *starts = a.array[0].buf;
    Py_ssize_t *columns = a.array[1].buf, m = a.array[1].shape[0];

    for (Py_ssize_t i = 0; i < m; i++)
        for (Py_ssize_t j = 0; j < 5; j++)
            columns[5 * i + j] = j < 3 ? starts[i] + j : starts[m + i] + j - 3;
    release(&a);
    Py_RETURN_NONE;
}

/*
 * project(lower, observed, blocks, R, P, H, S, own, n): return k. P and H have room for m d
 * columns, of which the first k are written.
 */
static PyObject *project(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    Arrays a;
    if (!take(&a, arguments, given, "didddddd", 1))
        return NULL;
    Py_buffer observed = a.array[1], blocks = a.array[2], R = a.array[3];
    const double *lower = a.array[0].buf;
    double *P = a.array[4].buf, *H = a.array[5].buf, *S = a.array[6].buf, *own = a.array[7].buf;
    Py_ssize_t capacity = a.array[0].shape[0], m = observed.shape[0], d = observed.shape[1];
    Py_ssize_t n = PyLong_AsSsize_t(arguments[8]), k = 0;
    Py_ssize_t *states = malloc((n + 1) * sizeof *states), *column_of = calloc(n, sizeof *column_of);
    if (!states || !column_of) {
        free(states), free(column_of), release(&a);
        return PyErr_NoMemory();
    }

    for (Py_ssize_t i = 0; i < m; i++)
        for (Py_ssize_t j = 0; j < d; j++)
            column_of[INDEX2(observed, i, j)] = 1;
    for (Py_ssize_t state = 0; state < n; state++)
        if (column_of[state]) {
            column_of[state] = k;
            states[k++] = state;
        }
    for (Py_ssize_t c = 0; c < k; c++) {
        Py_ssize_t j = states[c];
        double *column = P + c * capacity;
        for (Py_ssize_t i = 0; i < j; i++)
            column[i] = lower[i * capacity + j];
        memcpy(column + j, lower + j * capacity + j, (capacity - j) * sizeof(double));
    }
    memset(H, 0, 2 * m * k * sizeof(double));
    for (Py_ssize_t i = 0; i < m; i++)
        for (Py_ssize_t j = 0; j < d; j++) {
            Py_ssize_t c = column_of[INDEX2(observed, i, j)];
            /* A state may be listed twice in a row; its entries are added. */
            H[c * 2 * m + 2 * i] += AT3(blocks, i, 0, j);
            H[c * 2 * m + 2 * i + 1] += AT3(blocks, i, 1, j);
        }
    /* S = (H P) H^T, each row of H having d nonzeros. */
    for (Py_ssize_t i = 0; i < 2 * m; i++)
        for (Py_ssize_t l = 0; l <= i; l++) {
            double sum = 0.0;
            for (Py_ssize_t j = 0; j < d; j++) {
                const double *column = P + column_of[INDEX2(observed, l / 2, j)] * capacity;
                double HP = 0.0;
                for (Py_ssize_t e = 0; e < d; e++)
                    HP += AT3(blocks, i / 2, i % 2, e) * column[INDEX2(observed, i / 2, e)];
                sum += HP * AT3(blocks, l / 2, l % 2, j);
            }
            if (l / 2 == i / 2)
                own[4 * (i / 2) + 2 * (i % 2) + l % 2] = own[4 * (i / 2) + 2 * (l % 2) + i % 2] =
                    sum += AT3(R, i / 2, i % 2, l % 2);
            S[i * 2 * m + l] = S[l * 2 * m + i] = sum;
        }
    free(states), free(column_of), release(&a);
    return PyLong_FromSsize_t(k);
}

/* squared_distances(r, S, d2) */
static PyObject *squared_distances(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    Arrays a;
    if (!take(&a, arguments, given, "ddd", 0))
        return NULL;
    Py_buffer r = a.array[0], S = a.array[1];
    double *d2 = a.array[2].buf;

    for (Py_ssize_t i = 0; i < r.shape[0]; i++) {
        double x = AT2(r, i, 0), y = AT2(r, i, 1);
        double xx = AT3(S, i, 0, 0), xy = AT3(S, i, 1, 0), yy = AT3(S, i, 1, 1);
        d2[i] = (yy * x * x - 2.0 * xy * x * y + xx * y * y) / (xx * yy - xy * xy);
    }
    release(&a);
    Py_RETURN_NONE;
}

/*
 * correction(P, H, L, y, dx, W): L holds S at the start, y the residual and H the Jacobian, which
 * becomes L^-1 H; return log det S, or minus the order of the minor that is not positive definite.
 */
static PyObject *correction(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    Arrays a;
    if (!take(&a, arguments, given, "dddddd", 0))
        return NULL;
    double *P = a.array[0].buf, *H = a.array[1].buf, *L = a.array[2].buf, *y = a.array[3].buf;
    double *dx = a.array[4].buf, *W = a.array[5].buf, one = 1.0, zero = 0.0, log_det = 0.0;
    int capacity = (int)a.array[0].shape[0], k = (int)a.array[0].shape[1];
    int rows = (int)a.array[3].shape[0], n = (int)a.array[4].shape[0], step = 1, failed_at = 0;

    Py_BEGIN_ALLOW_THREADS
    dpotrf("L", &rows, L, &rows, &failed_at);
    if (!failed_at) {
        dtrsm("L", "L", "N", "N", &rows, &k, &one, L, &rows, H, &rows);
        dgemm("N", "T", &capacity, &rows, &k, &one, P, &capacity, H, &rows, &zero, W, &capacity);
        dtrsv("L", "N", "N", &rows, L, &rows, y, &step);
        dgemv("N", &n, &rows, &one, W, &capacity, y, &step, &zero, dx, &step);
        for (int i = 0; i < rows; i++)
            log_det += log(L[i * rows + i]);
    }
    Py_END_ALLOW_THREADS
    release(&a);
    if (failed_at)
        return PyErr_Format(
            PyExc_ArithmeticError, "innovation covariance not positive definite at %d", failed_at);
    return PyFloat_FromDouble(2.0 * log_det);
}

/* subtract_product(lower, W, n) */
static PyObject *subtract_product(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    Arrays a;
    if (!take(&a, arguments, given, "dd", 1))
        return NULL;
    double *lower = a.array[0].buf, *W = a.array[1].buf, one = 1.0, minus = -1.0;
    int capacity = (int)a.array[0].shape[0], k = (int)a.array[1].shape[1];
    int n = (int)PyLong_AsSsize_t(arguments[2]);

    Py_BEGIN_ALLOW_THREADS
    dsyrk("L", "N", &n, &k, &minus, W, &capacity, &one, lower, &capacity);
    Py_END_ALLOW_THREADS
    release(&a);
    Py_RETURN_NONE;
}

/* retracted(x, dx, headings, result) */
static PyObject *retracted(PyObject *module, PyObject *const *arguments, Py_ssize_t given)
{
    Arrays a;
    if (!take(&a, arguments, given, "ddid", 0))
        return NULL;
    Py_buffer x = a.array[0], dx = a.array[1], headings = a.array[2];
    double *result = a.array[3].buf;

    for (Py_ssize_t i = 0; i < x.shape[0]; i++)
        result[i] = AT1(x, i) + AT1(dx, i);
    for (Py_ssize_t i = 0; i < headings.shape[0]; i++) {
        double *heading = result + INDEX1(headings, i);
        *heading = wrap(*heading);
    }
    release(&a);
    Py_RETURN_NONE;
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
    FUNCTION(moved), FUNCTION(propagated), FUNCTION(settle), FUNCTION(h), FUNCTION(H),
    FUNCTION(observed_states), FUNCTION(project), FUNCTION(squared_distances),
    FUNCTION(correction), FUNCTION(subtract_product), FUNCTION(retracted),
    {NULL, NULL, 0, NULL}};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "_kernel", NULL, -1, functions, NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__kernel(void)
{
    const char *blas = "scipy.linalg.cython_blas", *lapack = "scipy.linalg.cython_lapack";
    if (!find(blas, "dgemm", (void **)&dgemm) || !find(blas, "dgemv", (void **)&dgemv)
            || !find(blas, "dsyrk", (void **)&dsyrk)
            || !find(blas, "dtrsm", (void **)&dtrsm)
            || !find(blas, "dtrsv", (void **)&dtrsv)
            || !find(lapack, "dpotrf", (void **)&dpotrf))
        return NULL;
    return PyModule_Create(&definition);
}
