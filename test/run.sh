#!/bin/sh
# Runs each test given as an argument ("program arguments"), one process each and two at a time, and closes with the sum of their
# 'N passed, N failed' lines. A test that crashes, or whose exit code and counts disagree, counts as a failure. First of all the runner
# shows that it can fail.
passed=0
failed=0

# sets p and f from the output's last line and the exit code; anything odd is one failure more
judge() {
    last=$(printf '%s\n' "$1" | tail -n 1)
    p=$(printf '%s\n' "$last" | sed -n 's/^\([0-9][0-9]*\) passed, \([0-9][0-9]*\) failed$/\1/p')
    f=$(printf '%s\n' "$last" | sed -n 's/^\([0-9][0-9]*\) passed, \([0-9][0-9]*\) failed$/\2/p')
    if [ -z "$p" ]; then p=0; f=1; return; fi
    if [ "$2" -ne 0 ] && [ "$f" -eq 0 ]; then f=1; fi
    if [ "$2" -eq 0 ] && { [ "$f" -ne 0 ] || [ "$p" -eq 0 ]; }; then f=$((f + 1)); fi
}

# the runner itself: a failing check, a crash, a lying exit code, a test that tests nothing
self() {
    judge "$1" "$2"
    found=good
    [ "$f" -eq 0 ] || found=bad
    if [ "$found" = "$3" ]; then passed=$((passed + 1))
    else failed=$((failed + 1)); echo "runner: '$1' with exit code $2 was not found $3"; fi
}
self '3 passed, 0 failed' 0 good
self '3 passed, 1 failed' 1 bad
self '3 passed, 1 failed' 0 bad
self '3 passed, 0 failed' 139 bad
self 'Segmentation fault' 139 bad
self '0 passed, 0 failed' 0 bad

# two at a time: each lane takes the next test that the other has not, and leaves what it printed and its exit code
folder=$(mktemp -d) || exit 1
trap 'rm -rf "$folder"' EXIT
lane() {
    i=0
    for test in "$@"; do
        i=$((i + 1))
        mkdir "$folder/$i" 2>/dev/null || continue
        begin=$(date +%s)
        sh -c "$test" >"$folder/$i.out" 2>&1
        echo $? >"$folder/$i.code"
        echo "== $test: $(tail -n 1 "$folder/$i.out"), $(($(date +%s) - begin)) s"
    done
}
lane "$@" &
lane "$@"
wait

i=0
for test in "$@"; do
    i=$((i + 1))
    judge "$(cat "$folder/$i.out")" "$(cat "$folder/$i.code")"
    [ "$f" -eq 0 ] || { echo "== failed: $test"; tail -n 40 "$folder/$i.out"; }
    passed=$((passed + p))
    failed=$((failed + f))
done
echo "$passed passed, $failed failed"
[ "$failed" -eq 0 ]
