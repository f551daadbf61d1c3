# Sourced by the other scripts: makes and repairs the private Python environment in .venv.
#
# `environment run` leaves a .venv in which robotd is installed, editable, at the versions of constraints.txt;
# `environment dev` adds what the tests need. Where nothing changed since the last time, it only looks.

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)
venv="$root/.venv"
unfinished="$venv/robotd-unfinished" # stands while packages are being put in; a set-up that was cut off is made anew

say() { printf 'robotd set-up: %s\n' "$*" >&2; }

die() {
    say "$*"
    exit 69
}

# What the environment was made from: the two files, and the folder, which is written into its programs.
fingerprint() { cat "$root/pyproject.toml" "$root/constraints.txt" - <<<"$root" | cksum; }

# True for a Python that this robotd runs on. A name may stand for a program that refuses to start: ask, don't guess.
suits() { "$1" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' >/dev/null 2>&1; }

makes_venvs() { "$1" -c 'import ensurepip, venv' >/dev/null 2>&1; }

# Sets `python`: the first that suits and can make environments, else the first that suits, else nothing.
find_python() {
    local candidate second=""
    for candidate in ${ROBOTD_PYTHON:+"$ROBOTD_PYTHON"} python3.13 python3.12 python3.11 python3; do
        suits "$candidate" || continue
        if makes_venvs "$candidate"; then
            python=$candidate
            return
        fi
        [ -n "$second" ] || second=$candidate
    done
    python=$second
}

# Debian and Ubuntu keep the venv module in a package of its own.
need_venv_module() {
    makes_venvs "$python" && return
    local version
    version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
    if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
        say "Python $version lacks the venv module; installing python$version-venv"
        if apt-get update -q >&2 && DEBIAN_FRONTEND=noninteractive \
            apt-get install -q -y --no-install-recommends "python$version-venv" >&2 && makes_venvs "$python"; then
            return
        fi
        die "python$version-venv could not be installed; install the venv module of $python by hand, then try again"
    fi
    die "Python $version lacks the venv module. Install it, then try again: sudo apt-get install python$version-venv"
}

make_venv() {
    if [ -n "${ROBOTD_PYTHON:-}" ] && ! suits "$ROBOTD_PYTHON"; then
        die "ROBOTD_PYTHON=$ROBOTD_PYTHON is not a Python 3.11, 3.12 or 3.13"
    fi
    find_python
    [ -n "$python" ] || die "robotd needs Python 3.11, 3.12 or 3.13, and none was found." \
        "On Debian 12 or Ubuntu 24.04: sudo apt-get install python3 python3-venv"
    need_venv_module
    say "making .venv with $("$python" -V) ($(command -v "$python"))"
    "$python" -m venv --clear "$venv" || die "the environment could not be made in $venv"
}

install_robotd() {
    local what=. pip=("$venv/bin/python" -m pip --disable-pip-version-check install -c "$root/constraints.txt")
    [ "$1" = run ] || what=".[$1]"
    say "installing the packages of constraints.txt (this takes a while only once)"
    : >"$unfinished"
    printf '%s\n' "$root" >"$venv/robotd-home"
    # the build tool first, so that it too comes in the pinned version
    (cd "$root" && "${pip[@]}" -q hatchling && "${pip[@]}" --no-build-isolation -e "$what") >&2 9>&- ||
        die "the packages could not be installed; see the lines above, then start again"
    rm -f "$unfinished"
}

environment() {
    local stamp="$venv/robotd-$1.stamp" wanted
    wanted=$(fingerprint)
    up_to_date && return

    # One at a time: the lock hangs on this shell's descriptor 9 and so ends with the shell, however that ends.
    find_python
    exec 9<"$root/pyproject.toml"
    if [ -n "$python" ] && ! "$python" -c 'import fcntl; fcntl.flock(9, fcntl.LOCK_EX | fcntl.LOCK_NB)' 2>/dev/null; then
        say "another set-up is at work; waiting for it"
        "$python" -c 'import fcntl; fcntl.flock(9, fcntl.LOCK_EX)'
    fi
    if ! up_to_date; then # else the one that we waited for did it
        if [ -e "$unfinished" ]; then
            say "the last set-up was cut off; starting anew"
            make_venv
        elif [ -e "$venv/robotd-home" ] && [ "$(<"$venv/robotd-home")" != "$root" ]; then
            say "the checkout was moved; starting anew"
            make_venv
        elif ! suits "$venv/bin/python" || ! "$venv/bin/python" -c 'import pip' 2>/dev/null; then
            make_venv
        fi
        install_robotd "$1"
        printf '%s\n' "$wanted" >"$stamp"
        [ "$1" = run ] || cp "$stamp" "$venv/robotd-run.stamp" # what serves the tests serves robotd
    fi
    exec 9<&-
}

up_to_date() { # reads `stamp` and `wanted` of its caller
    [ -x "$venv/bin/python" ] && [ ! -e "$unfinished" ] && [ -e "$stamp" ] && [ "$(<"$stamp")" = "$wanted" ]
}
