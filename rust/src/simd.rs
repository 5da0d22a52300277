//! Code compiled a second time, for processors with wider registers than every x86-64 has.
//!
//! The loops of the fast path are plain Rust that the compiler makes vectors of. What it may use for that is decided when
//! the crate is built, and a wheel must run everywhere: that is SSE2, which cannot even turn around the bytes of four
//! numbers at once. Compiled for AVX2, the same source takes a sixth less time in all. Other processors (ARM, say) always
//! have what is needed.

/// Calls a method, compiled for the best registers that this processor has. The method must be `#[inline(always)]`.
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
            // SAFETY: the processor has just been found to have what the function is compiled for.
            #[allow(unsafe_code)]
            return unsafe { with_avx2($this, $($argument),*) };
        }
        with_any($this, $($argument),*)
    }};
}
pub(crate) use widest;
