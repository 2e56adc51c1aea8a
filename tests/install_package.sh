#!/bin/sh
# install_package.sh PACKAGE PURPOSE: installs a Debian package where that is possible; exit status 1 where it is not.

if [ "$(id -u)" = 0 ]; then
    as_root=
elif command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null; then
    as_root="sudo -n"
else
    exit 1
fi
command -v apt-get >/dev/null 2>&1 || exit 1

echo "installing $1 for $2"
export DEBIAN_FRONTEND=noninteractive
# Short timeouts, for a machine without a network. Lists that fail to update may still do: only the outcome counts.
quick="-qq -o Acquire::Retries=0 -o Acquire::http::Timeout=20 -o Acquire::https::Timeout=20 -o DPkg::Lock::Timeout=60"
$as_root apt-get $quick update >/dev/null 2>&1
$as_root apt-get $quick install --yes --no-install-recommends "$1" >/dev/null 2>&1
