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

sh "$(dirname "$0")/install_package.sh" libllvm19 Mitsuba && exit 0
echo "no LLVM 16 or later here: Mitsuba, where it is installed, will run its slower scalar variant"
exit 0
