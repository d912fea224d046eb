#!/usr/bin/env bash
# Makes .venv from the lock that fits this machine. Called by `make setup`; running it again is cheap.
#   PYTHON=python3.12 requirements/setup.sh    to choose the interpreter
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

say() { printf 'setup: %s\n' "$*"; }
die() { printf 'setup: error: %s\n' "$*" >&2; exit 1; }

# Two `make` at once must not fill the same folder.
exec 9>.venv.lock
flock 9

fits() { "$1" -c 'import sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null; }
has() { "$1" -c "import $2" 2>/dev/null; }

# Running each candidate, not just finding it: version managers put names on PATH that do not start.
choose_python() {
  if [ -n "${PYTHON:-}" ]; then
    fits "$PYTHON" || die "PYTHON=$PYTHON does not run or is not 3.10 to 3.13; choose another: make setup PYTHON=python3.12"
    python=$PYTHON
    return
  fi
  local name without_venv=""
  if [ "${ROS_DISTRO:-}" = jazzy ] && fits python3 && has python3 rclpy; then
    python=python3  # The interpreter that ROS from apt was built for.
    return
  fi
  for name in python3.12 python3.11 python3.13 python3.10 python3; do
    fits "$name" || continue
    if has "$name" "venv, ensurepip"; then
      python=$name
      return
    fi
    without_venv=${without_venv:-$name}
  done
  python=$without_venv
  [ -n "$python" ] || die "no Python 3.10 to 3.13 found ($(python3 --version 2>&1 || true)); install one and run: make setup PYTHON=/path/to/python3.12"
}

need_venv_module() {
  has "$python" "venv, ensurepip" && return
  local package install
  package="python$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')-venv"
  install="apt-get install -y $package"
  if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    say "$python cannot make virtual environments; running: $install"
    { apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$package"; } \
      </dev/null >/dev/null || die "that failed; install $package by hand and repeat: make setup"
  else
    die "$python cannot make virtual environments; run: sudo $install"
  fi
}

choose_python
lock=plain
if [ "${ROS_DISTRO:-}" = jazzy ] && has "$python" rclpy; then
  lock=apt
elif [ -n "${ROS_DISTRO:-}" ]; then
  say "ROS '$ROS_DISTRO' is sourced, but $python cannot import a Jazzy rclpy from it: using the ROS wheels instead"
  unset PYTHONPATH
fi
machine=$("$python" -c 'import platform; print(platform.machine())')
if [ $lock = plain ] && [ "$machine" != x86_64 ]; then
  die "the ROS wheels exist for x86_64 only, this is $machine; install ROS 2 Jazzy from apt (Ubuntu 24.04), source /opt/ros/jazzy/setup.bash and repeat: make setup"
fi

mode="$lock $("$python" -c 'import sys; print(sys.base_prefix, sys.version)' | tr '\n' ' ')"
stamp=".venv/.stamp-$(cat pyproject.toml "requirements/$lock.lock" requirements/uv.lock requirements/setup.sh - <<<"$mode $PWD" | sha256sum | cut -c1-16)"

# Messages that the wheels lack, and our own. Without a C++ compiler everything flies, but nothing draws frames live.
make_interfaces() {
  [ $lock = plain ] || return 0
  local packages=(requirements/interfaces/*/ ros2_ws/src/ptnsbc_interfaces) made
  made=".venv/.interfaces-$(cat "$stamp" $(find requirements/interfaces "${packages[@]}" -type f | sort -u) | sha256sum | cut -c1-16)"
  [ ! -e "$made" ] || return 0
  if ! command -v g++ >/dev/null; then
    say "no g++: there are no types of ptnsbc_interfaces (fleet --operator) and no live /tf (bags have it); install g++ and repeat: make setup"
  elif .venv/bin/python requirements/interfaces/build.py "${packages[@]%/}"; then
    rm -f .venv/.interfaces-*
    touch "$made"
  else
    say "the message packages above could not be built: no fleet --operator or no live /tf (bags have it)"
  fi
}

if [ -e "$stamp" ] && .venv/bin/python -c '' 2>/dev/null; then
  make_interfaces
  exit 0
fi

need_venv_module
say "$("$python" --version), $lock.lock -> .venv"
if [ "$(cat .venv/.mode 2>/dev/null)" != "$mode" ] || ! .venv/bin/python -m pip --version >/dev/null 2>&1; then
  site=(); [ $lock = plain ] || site=(--system-site-packages)
  "$python" -m venv --clear "${site[@]}" .venv || die "could not make .venv with $python"
fi
rm -f .venv/.stamp-*
# --no-deps: a lock is complete, there is nothing to resolve. Every file must have a hash of the lock.
pip=(.venv/bin/python -m pip --quiet --disable-pip-version-check --no-input install --progress-bar off --no-deps)
install() { "${pip[@]}" "$@"; }
# uv installs a lock in a fifth of the time: the user's, or one of our own in .venv. Without it pip does everything.
uv=$(command -v uv || true)
export UV_SYSTEM_CERTS="${UV_SYSTEM_CERTS:-1}" UV_NATIVE_TLS="${UV_NATIVE_TLS:-1}"  # the computer's certificates, as pip's
if [ -z "$uv" ] && "${pip[@]}" --require-hashes -r requirements/uv.lock 2>/dev/null; then uv=.venv/bin/uv; fi
if [ -n "$uv" ]; then
  install() {
    "$uv" pip install --quiet --no-progress --python .venv/bin/python --no-deps "$@" ||
      { say "uv could not; trying pip"; "${pip[@]}" "$@"; }
  }
fi
install --require-hashes -r "requirements/$lock.lock" || die "requirements/$lock.lock could not be installed (see above); repeat with: make setup"
install --no-build-isolation -e . || die "this project could not be installed (see above)"
.venv/bin/python -c '
import numba, numpy, rclpy
print(f"setup: numpy {numpy.__version__}, numba {numba.__version__}, rclpy from {rclpy.__path__[0]}")' \
  || die "the packages are installed but do not load (see above); start afresh: make clean setup"
printf '%s' "$mode" >.venv/.mode
printf '%s' "$stamp" >"$stamp"
make_interfaces
say "done in $SECONDS s"
