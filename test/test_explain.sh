#!/bin/sh
# 'mlt explain': the printed numbers multiply out, every request finds its mutation or says that there is none, and the audit passes.
#
#   sh test/test_explain.sh [PROGRAM]      ./mlt if none is given
#
# The last line is 'N passed, N failed'; the status is 1 if anything failed.

. "$(dirname "$0")/check.sh"
mlt=$(absolute "${1:-./mlt}")
root=$(cd "$(dirname "$0")/.." && pwd) || exit 1
cd "$folder" || exit 1

# explain STATUS ARGUMENT... SCENE: the program must leave with that status; its two streams are files then
explain()
{
    wanted=$1
    shift
    "$mlt" explain "$@" >stdout 2>stderr
    status=$?
    check "status $status, not $wanted: mlt explain $*" test "$status" -eq "$wanted"
}

says() { grep -q -e "$1" "${2:-stdout}"; }
refuses() { explain 1 "$@"; check "no message: $*" test -s stderr; check "prints something all the same: $*" test ! -s stdout; }

# Every equation: pieces between '=' that are numbers alone must agree to 1e-6, and so must everything that goes by one name; C = F G F in tables.
# Prints the number of agreements.
cat >equations.awk <<'END_AWK'
function fail(text) { print "line " NR ": " text ": " $0 >"/dev/stderr"; bad = 1 }
function agree(a, b) { count++; return (a - b) * (a - b) <= 1e-12 * a * b || a == b }
function skip() { while (substr(text, at, 1) == " ") at++ }
function factor(  v, w) {
    skip()
    if (substr(text, at, 6) == "min(1,") { at += 6; v = sum(); at++; return v < 1 ? v : 1 }
    if (substr(text, at, 1) == "-") { at++; return -factor() }
    if (substr(text, at, 1) == "(") { at++; v = sum(); skip(); at++; return v }
    if (!match(substr(text, at), /^[0-9.]+(e[-+]?[0-9]+)?/)) { fail("not a number at " substr(text, at)); at = length(text) + 1; return 0 }
    w = RLENGTH
    v = substr(text, at, w) + 0
    at += w
    return v
}
function term(  v, c) {
    v = factor()
    for (skip(); (c = substr(text, at, 1)) == "*" || c == "/"; skip()) { at++; v = c == "*" ? v * factor() : v / factor() }
    return v
}
function sum(  v, c) {
    v = term()
    for (skip(); (c = substr(text, at, 1)) == "+" || c == "-"; skip()) { at++; v = c == "+" ? v + term() : v - term() }
    return v
}
function trim(s) { gsub(/^ +| +$/, "", s); return s }
/^  +(x_|z_|\()[^=]*$/ && NF >= 6 {                        # a table's row: vertex, F, S>, S<, G, C
    if (c != "-" && c != "" && $2 != "-" && f * g > 0 && !agree(f * g * $2, c)) fail("C of the row above is not F G F")
    f = $2; g = $5; c = $6
    if (f == "-" || g == "-") c = ""
    next
}
{ c = "" }
/(^|[^a-z])nan([^a-z]|$)/ { fail("not a number") }
/=/ {
    line = $0
    if (match(line, /[^ ]    /)) line = substr(line, 1, RSTART)    # four spaces: what follows is a remark
    gsub(/min\(1, /, "min(1,", line)
    parts = split(line, part, /, |; /)
    for (p = 1; p <= parts; p++) {
        pieces = split(part[p], piece, "=")
        if (pieces < 2) continue
        if (trim(piece[1]) != "") name = trim(piece[1])
        have = 0
        for (i = 2; i <= pieces; i++) {
            s = trim(piece[i])
            if (s !~ /^[-+*\/0-9.e() ]*(min\(1,)?[-+*\/0-9.e() ]*$/ || s !~ /[0-9]/) { have = 0; continue }
            text = s; at = 1; v = sum()
            if (have && !agree(v, last)) fail("these numbers do not agree: " v " and " last)
            have = 1; last = v
        }
        if (!have || name !~ /[][()^]/) continue           # plain letters are used again and again
        if ((name in value) && !agree(last, value[name])) fail(name " was " value[name] " before")
        value[name] = last
    }
}
END { print count + 0; exit bad }
END_AWK
# multiplies_out AT_LEAST: and that many comparisons were made
multiplies_out() { n=$(awk -f equations.awk stdout) && test "$n" -ge "$1"; }
# caught SED-SCRIPT: what it changes in the file 'right' is noticed
caught()
{
    sed "$1" right >stdout
    differ right stdout && not multiplies_out 5 2>/dev/null
}
explain 0 --strategy lens "$root/scenes/cornell.obj"
cp stdout right
check "planted: right equations do not hold" multiplies_out 5
check "planted: a result that is another" caught 's/^\( *R(y|x) = .* = \)[0-9.]*$/\11.5/'
check "planted: a factor that is another" caught 's/^\( *R(y|x) = .* = \)[0-9.]*\( \* .*\)$/\11.5\2/'
check "planted: C that is another" caught 's/^\( *z_0 .* \)[0-9.e-]*$/\11.5/'
check "planted: a name that changes its value" caught 's/^  R(y|x) = .*/&\n  R(y|x) = 1.5/'
check "planted: nan" caught 's/^\( *R(y|x) = .* = \)[0-9.]*$/\1nan/'

# ---- the lecture's two examples: a from the tables and p_d, p_a, chi alone ----

cat >example.awk <<'END_AWK'
/^THERE/ { half = "x" } /^AND BACK/ { half = "y" } /^EXAMPLE/ { half = "" }
half && $1 ~ /^p_d\^/ { p_d[half] = $NF }
half && $1 ~ /^p_a\^/ { p_a[half] = $NF }
half && $1 ~ /^chi/ { chi[half] = $3 }
half && $1 ~ /^[xz]_/ && NF == 6 { n[half]++; F[half, n[half]] = $2; S_lens[half, n[half]] = $3; S_light[half, n[half]] = $4; G[half, n[half]] = $5 }
$1 == "a(y|x)" { a = $NF }
function R(h,  j, i, q, all) {                             # rows 1 .. n are u_0 .. u_{m+1}
    for (j = 0; j <= n[h] - 2; j++) {
        q = F[h, j + 1] * G[h, j + 1] * F[h, j + 2]
        for (i = 1; i <= j; i++) q *= S_lens[h, i]
        for (i = j + 3; i <= n[h]; i++) q *= S_light[h, i]
        all += p_a[h] / q
    }
    return chi[h] / (p_d[h] * all)
}
END {
    mine = R("x") / R("y")                                 # q(x) = q(y): all is diffuse
    if (mine > 1) mine = 1
    if ((mine - a) ^ 2 > 1e-12 * a * a) { print "a is " a ", from the terms " mine; exit 1 }
}
END_AWK
for seed in 1 2 3; do
    for example in 1 2; do
        explain 0 --example $example --seed $seed "$root/scenes/cornell.obj"
        check "example $example: a equation does not hold" multiplies_out 25
        check "example $example: a(y|x)" awk -f example.awk stdout
        check "example $example: length of x" says "^x = .* k = $((example + 2)) edges"
        check "example $example: no slides' forms" says "^EXAMPLE $example"
    done
done
caught_in_example() { sed "$1" stdout >planted; differ stdout planted && not awk -f example.awk planted >/dev/null; }
check "planted: an a(y|x) that is another" caught_in_example 's/^\( *a(y|x) .* = \)[0-9.e-]*$/\10.123/'
explain 0 --example 1 --accepted "$root/scenes/cornell.obj"
check "example 1: not accepted" says "The chain accepted y"
check "example 1: deletion" says "delete: s = 1, t = 2"
check "example 1: addition" says "^THERE .* s' = 1, t' = 0"

# ---- every strategy, and what may be asked of it ----

# one ARGUMENT... SCENE: a mutation whose equations hold
one()
{
    explain 0 "$@"
    check "an equation does not hold: $*" multiplies_out 5
}
for scene in cornell caustic pool; do
    for strategy in bidir lens subpath; do one --strategy $strategy "$root/scenes/$scene.obj"; done
done
for strategy in caustic chain; do
    one --strategy $strategy "$root/scenes/caustic.obj"
    check "$strategy: another strategy" says "^A mutation by '$strategy'"
    check "$strategy: nothing specular moved" says "q S[<>]("
done
for scene in pool caustic; do one --strategy manifold --accepted "$root/scenes/$scene.obj"; done
for strategy in lens caustic chain manifold; do
    one --strategy $strategy --seed 2 --accepted "$root/test/scenes/narrow.obj"
    check "$strategy: no narrow lobe was passed" says "keeps its place in the narrow lobe"
done
one --strategy chain --accepted "$root/scenes/pool.obj"
check "chain: no turned direction" says "F|cos<|("
check "chain: not accepted" says "The chain accepted y"
for length in 3 6; do
    one --strategy bidir --length $length "$root/scenes/pool.obj"
    check "length $length" says "^x = .* k = $length edges"
done
for seed in 1 2 3 4 5 6 7 8; do one --strategy bidir --seed $seed "$root/test/scenes/underwater.obj"; done
"$mlt" explain --seed 9 "$root/scenes/cornell.obj" >again && "$mlt" explain --seed 9 "$root/scenes/cornell.obj" >stdout
check "the same seed gives another text" cmp -s again stdout

# ---- what cannot be had ----

refuses --strategy caustic "$root/scenes/cornell.obj"
refuses --length 9 --max-depth 5 "$root/scenes/cornell.obj"
refuses --example 2 --max-depth 4 "$root/scenes/cornell.obj"
refuses --example 1 --strategy lens "$root/scenes/cornell.obj"
refuses "$root/test/scenes/dark.obj"
refuses nowhere.obj

# ---- the audit ----

for scene in scenes/cornell scenes/caustic test/scenes/narrow; do
    explain 0 --audit -n 5000 "$root/$scene.obj"
    check "audit of $scene: no row" says "^bidir  *5000 "
    check "audit of $scene: something is off" not says OFF
done

for scene in pool caustic; do
    explain 0 --audit -n 3000 --strategy manifold "$root/scenes/$scene.obj"
    check "audit of manifold in $scene: nothing compared" says "^manifold  *[1-9][0-9][0-9]"
    check "audit of manifold in $scene: something is off" not says OFF
done
explain 0 --audit -n 2000 --strategy lens "$root/scenes/cornell.obj"
check "audit of lens: no row" says "^lens  *[1-9]"
check "audit of lens: another row" not says "^bidir"
explain 0 --audit -n 100 "$root/scenes/cornell.obj"
check "audit of next to nothing: does not say so" says "^bidir .*too few to test"

# ---- options that would mean nothing ----

for options in '--audit --example 1' '--audit --length 3' '--audit --accepted' '-n 100' '-v'; do
    explain 2 $options "$root/scenes/cornell.obj"
    check "no hint: $options" says "--help" stderr
    check "prints something all the same: $options" test ! -s stdout
done

report
