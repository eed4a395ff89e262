/** real_tanh */
static real real_tanh(real value)
{
    return {{ "tanhf" if single else "tanh" }}(value);
}

/** real_exp */
static real real_exp(real value)
{
    return {{ "expf" if single else "exp" }}(value);
}

/** real_sqrt */
static real real_sqrt(real value)
{
    return {{ "sqrtf" if single else "sqrt" }}(value);
}

/** real_pow */
static real real_pow(real base, real exponent)
{
    return {{ "powf" if single else "pow" }}(base, exponent);
}

/** real_rint */
static real real_rint(real value)
{
    return {{ "rintf" if single else "rint" }}(value);
}

/** absolute */
static real absolute(real value)
{
    return {{ "fabsf" if single else "fabs" }}(value);
}

/** logistic */
/* By a tanh, which cannot overflow. */
static real logistic(real value)
{
    return {{ 0.5|real }} + {{ 0.5|real }} * real_tanh({{ 0.5|real }} * value);
}

/** smaller */
static real smaller(real a, real b)
{
    return (a < b) ? a : b;
}

/** larger */
static real larger(real a, real b)
{
    return (a > b) ? a : b;
}

/** clip */
/* A NaN passes, to be found at the end of the step. */
static real clip(real value, real low, real high)
{
    real inside = value;

    if (value < low) {
        inside = low;
    }
    if (value > high) {
        inside = high;
    }
    return inside;
}

/** number_or_zero */
static real number_or_zero(real value)
{
    return isnan(value) ? {{ 0.0|real }} : value;
}

/** rounded */
/* What the Python controllers hand on is in single precision. */
static real rounded(real value)
{
    return (real)(float)value;
}

/** fill */
static void fill(real *to, int count, real value)
{
    for (int i = 0; i < count; i++) {
        to[i] = value;
    }
}

/** copy */
static void copy(const real *from, real *to, int count)
{
    for (int i = 0; i < count; i++) {
        to[i] = from[i];
    }
}

/** dot */
/* Eight sums side by side, which a processor can add at the same time. */
static real dot(const real *a, const real *b, int count)
{
    real sums[8] = { {{ 0.0|real }} };
    int i = 0;

    for (; i + 7 < count; i += 8) {
        for (int j = 0; j < 8; j++) {
            sums[j] += a[i + j] * b[i + j];
        }
    }
    for (; i < count; i++) {
        sums[0] += a[i] * b[i];
    }
    return ((sums[0] + sums[1]) + (sums[2] + sums[3])) + ((sums[4] + sums[5]) + (sums[6] + sums[7]));
}

/** product */
/* result = matrix vector; the matrix row by row. */
static void product(const real *matrix, int rows, int columns, const real *vector, real *result)
{
    for (int i = 0; i < rows; i++) {
        result[i] = dot(&matrix[i * columns], vector, columns);
    }
}

/** sparse_product */
/* result = matrix vector; of the matrix what is not zero, row by row, its columns, and each row's end. */
static void sparse_product(const real *values, const int *columns, const int *ends, int rows, const real *vector, real *result)
{
    int at = 0;

    for (int i = 0; i < rows; i++) {
        real sum = {{ 0.0|real }};

        for (; at < ends[i]; at++) {
            sum += values[at] * vector[columns[at]];
        }
        result[i] = sum;
    }
}

/** add_product */
/* result += matrix vector. */
static void add_product(const real *matrix, int rows, int columns, const real *vector, real *result)
{
    for (int i = 0; i < rows; i++) {
        result[i] += dot(&matrix[i * columns], vector, columns);
    }
}

/** affine */
/* result = matrix vector + bias. */
static void affine(const real *matrix, const real *bias, int rows, int columns, const real *vector, real *result)
{
    for (int i = 0; i < rows; i++) {
        result[i] = dot(&matrix[i * columns], vector, columns) + bias[i];
    }
}

/** multiply */
/* result = a b, of rows x inner and inner x columns. */
static void multiply(const real *a, const real *b, int rows, int inner, int columns, real *result)
{
    for (int i = 0; i < rows; i++) {
        for (int j = 0; j < columns; j++) {
            real sum = {{ 0.0|real }};

            for (int k = 0; k < inner; k++) {
                sum += a[i * inner + k] * b[k * columns + j];
            }
            result[i * columns + j] = sum;
        }
    }
}
