// Vectors, matrices and built-in functions of WGSL in CUDA C++, as far as the kernels use them. `cuda_source.py` translates the kernels.
#define FN __device__ __forceinline__
#ifndef STORAGE
#define STORAGE(T) T* __restrict__
#endif
namespace wgsl {

template <class T> struct vec2;
template <class T> struct vec3;
template <class T> struct vec4;

#define PAIR(V, T, SIGN, ...)                                                 \
    FN friend V operator SIGN(V a, V b) { return V(__VA_ARGS__); }            \
    FN friend V operator SIGN(V a, T s) { return a SIGN V(s); }               \
    FN friend V operator SIGN(T s, V b) { return V(s) SIGN b; }               \
    template <class S> FN V& operator SIGN##=(S b) { return *this = *this SIGN b; }

template <class T> struct __align__(2 * sizeof(T)) vec2 {
    T x, y;
    vec2() = default;
    FN explicit vec2(T s) : x(s), y(s) {}
    FN vec2(T x, T y) : x(x), y(y) {}
    template <class S> FN explicit vec2(vec2<S> v) : x(T(v.x)), y(T(v.y)) {}
    FN T& operator[](unsigned i) { return (&x)[i]; }
    FN const T& operator[](unsigned i) const { return (&x)[i]; }
    PAIR(vec2, T, +, a.x + b.x, a.y + b.y)
    PAIR(vec2, T, -, a.x - b.x, a.y - b.y)
    PAIR(vec2, T, *, a.x * b.x, a.y * b.y)
    PAIR(vec2, T, /, a.x / b.x, a.y / b.y)
    FN friend vec2 operator&(vec2 a, vec2 b) { return vec2(a.x & b.x, a.y & b.y); }
    FN friend vec2 operator-(vec2 a) { return vec2(-a.x, -a.y); }
    FN friend vec2<bool> operator<=(vec2 a, vec2 b) { return vec2<bool>(a.x <= b.x, a.y <= b.y); }
    FN friend vec2<bool> operator<(vec2 a, vec2 b) { return vec2<bool>(a.x < b.x, a.y < b.y); }
    FN friend vec2<bool> operator>(vec2 a, vec2 b) { return b < a; }
};

template <class T> struct vec3 {
    T x, y, z;
    vec3() = default;
    FN explicit vec3(T s) : x(s), y(s), z(s) {}
    FN vec3(T x, T y, T z) : x(x), y(y), z(z) {}
    FN vec3(vec2<T> v, T z) : x(v.x), y(v.y), z(z) {}
    FN vec3(T x, vec2<T> v) : x(x), y(v.x), z(v.y) {}
    template <class S> FN explicit vec3(vec3<S> v) : x(T(v.x)), y(T(v.y)), z(T(v.z)) {}
    FN vec2<T> xy() const { return vec2<T>(x, y); }
    FN T& operator[](unsigned i) { return (&x)[i]; }
    FN const T& operator[](unsigned i) const { return (&x)[i]; }
    PAIR(vec3, T, +, a.x + b.x, a.y + b.y, a.z + b.z)
    PAIR(vec3, T, -, a.x - b.x, a.y - b.y, a.z - b.z)
    PAIR(vec3, T, *, a.x * b.x, a.y * b.y, a.z * b.z)
    PAIR(vec3, T, /, a.x / b.x, a.y / b.y, a.z / b.z)
    FN friend vec3 operator&(vec3 a, vec3 b) { return vec3(a.x & b.x, a.y & b.y, a.z & b.z); }
    FN friend vec3 operator-(vec3 a) { return vec3(-a.x, -a.y, -a.z); }
    FN friend vec3<bool> operator>(vec3 a, vec3 b) { return vec3<bool>(a.x > b.x, a.y > b.y, a.z > b.z); }
    FN friend vec3<bool> operator!=(vec3 a, vec3 b) { return vec3<bool>(a.x != b.x, a.y != b.y, a.z != b.z); }
};

template <class T> struct __align__(4 * sizeof(T)) vec4 {
    T x, y, z, w;
    vec4() = default;
    FN explicit vec4(T s) : x(s), y(s), z(s), w(s) {}
    FN vec4(T x, T y, T z, T w) : x(x), y(y), z(z), w(w) {}
    FN vec4(vec2<T> v, T z, T w) : x(v.x), y(v.y), z(z), w(w) {}
    FN vec4(T x, vec2<T> v, T w) : x(x), y(v.x), z(v.y), w(w) {}
    FN vec4(vec3<T> v, T w) : x(v.x), y(v.y), z(v.z), w(w) {}
    FN vec4(T x, vec3<T> v) : x(x), y(v.x), z(v.y), w(v.z) {}
    FN vec2<T> xy() const { return vec2<T>(x, y); }
    FN vec2<T> xz() const { return vec2<T>(x, z); }
    FN vec2<T> yz() const { return vec2<T>(y, z); }
    FN vec2<T> yw() const { return vec2<T>(y, w); }
    FN vec2<T> zw() const { return vec2<T>(z, w); }
    FN vec3<T> xyz() const { return vec3<T>(x, y, z); }
    FN vec3<T> yzw() const { return vec3<T>(y, z, w); }
    FN T& operator[](unsigned i) { return (&x)[i]; }
    FN const T& operator[](unsigned i) const { return (&x)[i]; }
    PAIR(vec4, T, +, a.x + b.x, a.y + b.y, a.z + b.z, a.w + b.w)
    PAIR(vec4, T, -, a.x - b.x, a.y - b.y, a.z - b.z, a.w - b.w)
    PAIR(vec4, T, *, a.x * b.x, a.y * b.y, a.z * b.z, a.w * b.w)
    PAIR(vec4, T, /, a.x / b.x, a.y / b.y, a.z / b.z, a.w / b.w)
    FN friend vec4 operator-(vec4 a) { return vec4(-a.x, -a.y, -a.z, -a.w); }
};

using vec2f = vec2<float>;
using vec3f = vec3<float>;
using vec4f = vec4<float>;
using vec2i = vec2<int>;
using vec4i = vec4<int>;
using vec2u = vec2<unsigned>;
using vec3u = vec3<unsigned>;
using vec4u = vec4<unsigned>;

FN float exp(float a) { return ::expf(a); }
FN float exp2(float a) { return ::exp2f(a); }
FN float log(float a) { return ::logf(a); }
FN float log2(float a) { return ::log2f(a); }
FN float sqrt(float a) { return ::sqrtf(a); }
FN float floor(float a) { return ::floorf(a); }
FN float ceil(float a) { return ::ceilf(a); }
FN float abs(float a) { return ::fabsf(a); }
FN float fma(float a, float b, float c) { return ::fmaf(a, b, c); }
FN float sign(float a) { return float(a > 0.0f) - float(a < 0.0f); }
FN float min(float a, float b) { return ::fminf(a, b); }
FN float max(float a, float b) { return ::fmaxf(a, b); }
FN unsigned min(unsigned a, unsigned b) { return a < b ? a : b; }
FN float clamp(float a, float low, float high) { return min(max(a, low), high); }

// The same for each component.
#define EACH(NAME)                                                                          \
    FN vec2f NAME(vec2f a) { return vec2f(NAME(a.x), NAME(a.y)); }                          \
    FN vec3f NAME(vec3f a) { return vec3f(NAME(a.x), NAME(a.y), NAME(a.z)); }               \
    FN vec4f NAME(vec4f a) { return vec4f(NAME(a.x), NAME(a.y), NAME(a.z), NAME(a.w)); }
EACH(exp)
EACH(sqrt)
EACH(floor)
EACH(ceil)
EACH(abs)
EACH(sign)
FN vec3f max(vec3f a, vec3f b) { return vec3f(max(a.x, b.x), max(a.y, b.y), max(a.z, b.z)); }
FN vec2f clamp(vec2f a, vec2f low, vec2f high) { return vec2f(clamp(a.x, low.x, high.x), clamp(a.y, low.y, high.y)); }
FN vec3f clamp(vec3f a, vec3f low, vec3f high) {
    return vec3f(clamp(a.x, low.x, high.x), clamp(a.y, low.y, high.y), clamp(a.z, low.z, high.z));
}

FN float dot(vec2f a, vec2f b) { return a.x * b.x + a.y * b.y; }
FN float dot(vec3f a, vec3f b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
FN float dot(vec4f a, vec4f b) { return a.x * b.x + a.y * b.y + a.z * b.z + a.w * b.w; }
FN float length(vec2f a) { return sqrt(dot(a, a)); }
FN float length(vec3f a) { return sqrt(dot(a, a)); }
FN vec3f cross(vec3f a, vec3f b) { return vec3f(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x); }
FN bool all(vec2<bool> a) { return a.x && a.y; }
template <class T> FN T select(T no, T yes, bool condition) { return condition ? yes : no; }
FN vec2f select(vec2f no, vec2f yes, vec2<bool> c) { return vec2f(c.x ? yes.x : no.x, c.y ? yes.y : no.y); }
FN vec3f select(vec3f no, vec3f yes, vec3<bool> c) {
    return vec3f(c.x ? yes.x : no.x, c.y ? yes.y : no.y, c.z ? yes.z : no.z);
}

struct mat2x2f {  // columns
    vec2f a, b;
    mat2x2f() = default;
    FN mat2x2f(vec2f a, vec2f b) : a(a), b(b) {}
    FN mat2x2f(float a, float b, float c, float d) : a(a, b), b(c, d) {}
    FN const vec2f& operator[](unsigned i) const { return (&a)[i]; }
    FN friend vec2f operator*(mat2x2f m, vec2f v) { return m.a * v.x + m.b * v.y; }
    FN friend mat2x2f operator*(mat2x2f m, mat2x2f n) { return mat2x2f(m * n.a, m * n.b); }
};
struct mat3x3f {  // columns
    vec3f a, b, c;
    mat3x3f() = default;
    FN mat3x3f(vec3f a, vec3f b, vec3f c) : a(a), b(b), c(c) {}
    FN vec3f& operator[](unsigned i) { return (&a)[i]; }
    FN const vec3f& operator[](unsigned i) const { return (&a)[i]; }
    FN friend vec3f operator*(mat3x3f m, vec3f v) { return m.a * v.x + m.b * v.y + m.c * v.z; }
    FN friend vec3f operator*(vec3f v, mat3x3f m) { return vec3f(dot(v, m.a), dot(v, m.b), dot(v, m.c)); }
};

FN unsigned as_u32(float a) { return __float_as_uint(a); }
FN float as_f32(unsigned a) { return __uint_as_float(a); }
FN vec4f unpack4x8unorm(unsigned a) {
    return vec4f(float(a & 255u), float(a >> 8 & 255u), float(a >> 16 & 255u), float(a >> 24)) / vec4f(255.0f);
}

FN void workgroupBarrier() { __syncthreads(); }
FN void storageBarrier() { __syncthreads(); }
FN unsigned atomicLoad(const unsigned* a) { return *(const volatile unsigned*)a; }
FN void atomicStore(unsigned* a, unsigned value) { *(volatile unsigned*)a = value; }
FN unsigned workgroupUniformLoad(const unsigned* a) {
    __syncthreads();
    const unsigned value = *a;
    __syncthreads();
    return value;
}
FN float subgroupAdd(float a) {  // all threads of the warp take part
    for (int step = warpSize / 2; step > 0; step /= 2) { a += __shfl_xor_sync(0xffffffffu, a, step); }
    return a;
}
FN vec3f subgroupAdd(vec3f a) { return vec3f(subgroupAdd(a.x), subgroupAdd(a.y), subgroupAdd(a.z)); }

}  // namespace wgsl
