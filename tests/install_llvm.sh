#!/bin/sh
# Installs LLVM's shared library where Mitsuba can use it: it compiles its fast variant with LLVM 16 or later.
# Nothing fails without it: Mitsuba then runs its scalar variant, ten times slower. Always exits 0.

for library in /usr/lib/*/libLLVM*.so* /usr/lib/libLLVM*.so* /usr/lib64/libLLVM*.so* /usr/lib/llvm*/lib/libLLVM*.so* \
    /usr/local/lib/libLLVM*.so* /opt/homebrew/opt/llvm*/lib/libLLVM*.dylib "${DRJIT_LIBLLVM_PATH:-}"; do
    [ -e "$library" ] || continue
    # The first number in libLLVM-19.so, libLLVM.so.19.1 or /usr/lib/llvm-19/lib/libLLVM.so, whatever the folders before.
    version=$(echo "$library" | sed -n \
        -e 's|.*libLLVM[^0-9]*\([0-9][0-9]*\).*|\1|p' -e t -e 's|.*/llvm[^0-9/]*\([0-9][0-9]*\).*|\1|p')
    [ "${version:-0}" -ge 16 ] && exit 0
done

if [ "$(id -u)" = 0 ]; then
    as_root=
elif command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null; then
    as_root="sudo -n"
else
    as_root=no
fi

if [ "$as_root" != no ] && command -v apt-get >/dev/null 2>&1; then
    echo "installing libllvm19 for Mitsuba"
    export DEBIAN_FRONTEND=noninteractive
    # Short timeouts, for a machine without a network. Lists that fail to update may still do: only the outcome counts.
    quick="-qq -o Acquire::Retries=0 -o Acquire::http::Timeout=20 -o Acquire::https::Timeout=20 -o DPkg::Lock::Timeout=60"
    $as_root apt-get $quick update >/dev/null 2>&1
    $as_root apt-get $quick install --yes --no-install-recommends libllvm19 >/dev/null 2>&1 && exit 0
fi

echo "no LLVM 16 or later here: Mitsuba, where it is installed, will run its slower scalar variant"
exit 0
