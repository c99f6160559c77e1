# What the shell tests share, to be sourced by them: . "$(dirname "$0")/check.sh"
# A folder of the test's own, $folder, where mktemp puts it (TMPDIR), that is removed at the end; counted checks; the last line.

folder=$(mktemp -d) || exit 1
trap 'rm -rf "$folder"' EXIT
trap 'exit 1' HUP INT TERM
passed=0 failed=0

# check WHAT COMMAND...: the command must succeed
check()
{
    what=$1
    shift
    if "$@"; then passed=$((passed + 1)); else failed=$((failed + 1)); echo "failed: $what"; fi
}

not() { ! "$@"; }

# differ A B: both are there, and not the same
differ() { cmp -s "$1" "$2"; test $? -eq 1; }

# a file's name that holds from any folder
absolute() { case $1 in /*) echo "$1" ;; *) echo "$PWD/$1" ;; esac; }

# the last line; the status is 1 if anything failed, or nothing was checked
report()
{
    echo "$passed passed, $failed failed"
    test "$failed" -eq 0 && test "$passed" -gt 0
}
