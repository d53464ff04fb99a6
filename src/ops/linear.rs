//! Vectors and 3×3 matrices of the reference twins. Matrices are rows.

use super::Real;

pub type Vector<T> = [T; 3];
pub type Matrix<T> = [[T; 3]; 3];

pub fn add<T: Real>(a: Vector<T>, b: Vector<T>) -> Vector<T> {
    std::array::from_fn(|i| a[i] + b[i])
}

pub fn sub<T: Real>(a: Vector<T>, b: Vector<T>) -> Vector<T> {
    std::array::from_fn(|i| a[i] - b[i])
}

pub fn scale<T: Real>(s: T, a: Vector<T>) -> Vector<T> {
    a.map(|x| s * x)
}

/// `a += b`
pub fn accumulate<T: Real>(a: &mut Vector<T>, b: Vector<T>) {
    *a = add(*a, b);
}

pub fn dot<T: Real>(a: Vector<T>, b: Vector<T>) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub fn cross<T: Real>(a: Vector<T>, b: Vector<T>) -> Vector<T> {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

pub fn identity<T: Real>() -> Matrix<T> {
    std::array::from_fn(|i| std::array::from_fn(|j| if i == j { T::one() } else { T::zero() }))
}

pub fn transpose<T: Real>(m: &Matrix<T>) -> Matrix<T> {
    std::array::from_fn(|i| std::array::from_fn(|j| m[j][i]))
}

pub fn mul<T: Real>(m: &Matrix<T>, v: Vector<T>) -> Vector<T> {
    std::array::from_fn(|i| dot(m[i], v))
}

/// `mᵀ v`
pub fn mul_transposed<T: Real>(m: &Matrix<T>, v: Vector<T>) -> Vector<T> {
    mul(&transpose(m), v)
}

pub fn product<T: Real>(a: &Matrix<T>, b: &Matrix<T>) -> Matrix<T> {
    let columns = transpose(b);
    std::array::from_fn(|i| std::array::from_fn(|j| dot(a[i], columns[j])))
}

/// `a bᵀ`
pub fn outer<T: Real>(a: Vector<T>, b: Vector<T>) -> Matrix<T> {
    std::array::from_fn(|i| scale(a[i], b))
}

pub fn add_matrix<T: Real>(a: &Matrix<T>, b: &Matrix<T>) -> Matrix<T> {
    std::array::from_fn(|i| add(a[i], b[i]))
}

pub fn sub_matrix<T: Real>(a: &Matrix<T>, b: &Matrix<T>) -> Matrix<T> {
    std::array::from_fn(|i| sub(a[i], b[i]))
}
