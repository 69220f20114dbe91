// SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
// SPDX-License-Identifier: Apache-2.0

/*
 * Products of a covariance's size with few columns inside, for processors with AVX-512.
 *
 * They are most of an update of a large map. BLAS first packs what it multiplies, which takes long
 * for few columns, and OpenBLAS uses AVX2 on processors that it does not know. Here, tiles of C
 * stay in registers while all columns are subtracted from them. All matrices are in Fortran order.
 */

#include <immintrin.h>
#include <stddef.h>

#define AVX512 static inline __attribute__((always_inline, target("avx512f")))

/* Numbers in a vector, which are rows of C, and columns of a tile. */
#define WIDTH 8
/* Vectors in a column of a tile: 3 x 8 sums, 3 vectors of A and a number of B fit the registers. */
#define TALL 3
/* Rows of A that stay in the cache; a multiple of WIDTH. */
#define CACHED_ROWS 480
/* Columns that are subtracted together. */
#define MAX_RANK 128

typedef ptrdiff_t Index;

/* C -= A B^T for a tile of TALL vectors and WIDTH columns, with B (WIDTH, rank) packed. */
AVX512 void subtract_tile(
    Index rank, const double *A, Index A_stride, const double *B, double *C, Index C_stride)
{
    __m512d sum[WIDTH][TALL];
    for (int j = 0; j < WIDTH; j++)
        for (int v = 0; v < TALL; v++)
            sum[j][v] = _mm512_loadu_pd(C + j * C_stride + v * WIDTH);
    for (Index l = 0; l < rank; l++)
        for (int j = 0; j < WIDTH; j++)
            for (int v = 0; v < TALL; v++)
                sum[j][v] = _mm512_fnmadd_pd(
                    _mm512_loadu_pd(A + l * A_stride + v * WIDTH),
                    _mm512_set1_pd(B[l * WIDTH + j]), sum[j][v]);
    for (int j = 0; j < WIDTH; j++)
        for (int v = 0; v < TALL; v++)
            _mm512_storeu_pd(C + j * C_stride + v * WIDTH, sum[j][v]);
}

/* The same for a tile of at most one vector and WIDTH columns; or for its lower triangle. */
AVX512 void subtract_edge(
    Index rows, Index columns, int is_lower, Index rank, const double *A, Index A_stride,
    const double *B, double *C, Index C_stride)
{
    __m512d sum[WIDTH];
    __mmask8 of_rows = (__mmask8)((1 << rows) - 1), own[WIDTH];
    for (int j = 0; j < WIDTH; j++) {
        own[j] = j < columns ? of_rows & (__mmask8)(0xff << (is_lower ? j : 0)) : 0;
        /* Access to memory with an empty mask is as slow as a fault. */
        sum[j] = own[j] ? _mm512_maskz_loadu_pd(own[j], C + j * C_stride) : _mm512_setzero_pd();
    }
    for (Index l = 0; l < rank; l++)
        for (int j = 0; j < WIDTH; j++)
            sum[j] = _mm512_fnmadd_pd(
                _mm512_maskz_loadu_pd(of_rows, A + l * A_stride),
                _mm512_set1_pd(B[l * WIDTH + j]), sum[j]);
    for (int j = 0; j < WIDTH; j++)
        if (own[j])
            _mm512_mask_storeu_pd(C + j * C_stride, own[j], sum[j]);
}

/* C -= A B^T of A (m, rank) and B (n, rank), rank <= MAX_RANK; or for the lower triangle of C. */
static __attribute__((target("avx512f"))) void subtract_rank(
    Index m, Index n, Index rank, int is_lower, const double *A, Index A_stride, const double *B,
    Index B_stride, double *C, Index C_stride)
{
    double packed[MAX_RANK * WIDTH];
    for (Index first = 0; first < m; first += CACHED_ROWS) {
        Index last = m - first < CACHED_ROWS ? m : first + CACHED_ROWS;
        for (Index j = 0; j < (is_lower ? last : n); j += WIDTH) {
            Index columns = n - j < WIDTH ? n - j : WIDTH;
            double *C_j = C + j * C_stride;
            __mmask8 of_columns = (__mmask8)((1 << columns) - 1);
            for (Index l = 0; l < rank; l++)
                _mm512_storeu_pd(
                    packed + l * WIDTH, _mm512_maskz_loadu_pd(of_columns, B + l * B_stride + j));
            for (Index i = is_lower && j > first ? j : first; i < last;) {
                int is_diagonal = is_lower && i == j;
                Index rows = last - i < WIDTH ? last - i : WIDTH;
                if (columns == WIDTH && last - i >= TALL * WIDTH && !is_diagonal) {
                    subtract_tile(rank, A + i, A_stride, packed, C_j + i, C_stride);
                    i += TALL * WIDTH;
                } else {
                    subtract_edge(
                        rows, columns, is_diagonal, rank, A + i, A_stride, packed, C_j + i,
                        C_stride);
                    i += WIDTH;
                }
            }
        }
    }
}

/* C -= A B^T of A (m, k) and B (n, k); if A is B, for the lower triangle of C. */
static void subtract_by_tiles(
    Index m, Index n, Index k, const double *A, Index A_stride, const double *B, Index B_stride,
    double *C, Index C_stride)
{
    for (Index l = 0; l < k; l += MAX_RANK)
        subtract_rank(
            m, n, k - l < MAX_RANK ? k - l : MAX_RANK, A == B, A + l * A_stride, A_stride,
            B + l * B_stride, B_stride, C, C_stride);
}
