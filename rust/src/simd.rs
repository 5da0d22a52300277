//! Compiles a method twice: for every x86-64 processor, and for those with AVX2.
//!
//! The loops of the fast path are plain Rust that the compiler vectorizes. Which instructions it may use is decided when the
//! crate is built, and a wheel must run on every processor: with SSE2, which cannot even swap the bytes of four numbers at
//! once. Compiled for AVX2, the same source takes a sixth less time. Other architectures, like ARM, always have what these
//! loops need.

/// Calls a method, compiled for AVX2 if this processor has it. The method must be `#[inline(always)]`.
macro_rules! widest {
    ($this:ident: $This:ty, $method:ident($($argument:ident: $type:ty),*) -> $result:ty) => {{
        #[cfg(target_arch = "x86_64")]
        #[target_feature(enable = "avx2,movbe")]
        fn with_avx2(this: $This, $($argument: $type),*) -> $result {
            this.$method($($argument),*)
        }
        #[inline(never)]
        fn with_any(this: $This, $($argument: $type),*) -> $result {
            this.$method($($argument),*)
        }
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("movbe") {
            // SAFETY: the processor has the features that the function is compiled for.
            #[allow(unsafe_code)]
            return unsafe { with_avx2($this, $($argument),*) };
        }
        with_any($this, $($argument),*)
    }};
}
pub(crate) use widest;
