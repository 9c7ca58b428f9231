"""Words of `kernels/lanes.py` that are C++ by hand: vectors of lanes, and what Warp's functions are for them."""

import re
import textwrap

_INLINE = "[[gnu::always_inline]] static"

_TYPES = f"""\
struct Lanes {{
    typedef float V __attribute__((ext_vector_type(LANES)));
    typedef int I __attribute__((ext_vector_type(LANES)));
    {_INLINE} bool any(I mask) {{ return __builtin_reduce_or(mask); }}
    {_INLINE} V choose(I mask, V a, V b) {{ return mask ? a : b; }}
    {_INLINE} I choose(I mask, I a, I b) {{ return mask ? a : b; }}
"""

# A word is written out where the functions use it. `at` are places of an array, `count` how many lanes there are.
_WORDS = {
    "load": """V load(const float* a, int begin, int count)
{
    V x;
    if (count == LANES)
        __builtin_memcpy(&x, a + begin, sizeof(V));
    else
        for (int k = 0; k < LANES; ++k)
            x[k] = a[begin + (k < count ? k : count - 1)];
    return x;
}""",
    "gather": """V gather(const float* a, I at) { V x; for (int k = 0; k < LANES; ++k) x[k] = a[at[k]]; return x; }
I gather(const int* a, I at) { I x; for (int k = 0; k < LANES; ++k) x[k] = a[at[k]]; return x; }""",
    "store": """void store(float* a, I at, int count, V x)
{
    if (count == LANES)
        for (int k = 0; k < LANES; ++k)
            a[at[k]] = x[k];
    else
        for (int k = 0; k < count; ++k)
            a[at[k]] = x[k];
}
void store(float* a, I at, int count, I mask, V x)
{
    for (int k = 0; k < count; ++k)
        if (mask[k])
            a[at[k]] = x[k];
}""",
    "sqrt": "V sqrt(V x) { return __builtin_elementwise_sqrt(x); }",
    "abs": "V abs(V x) { return __builtin_elementwise_abs(x); }",
    "floor": "V floor(V x) { return __builtin_elementwise_floor(x); }",
    "min": "V min(V a, V b) { return a < b ? a : b; }",
    "max": "V max(V a, V b) { return a > b ? a : b; }",
    "clamp": "V clamp(V x, V low, V high) { x = low > x ? low : x; return x < high ? x : high; }",
    "sin": "V sin(V x) { for (int k = 0; k < LANES; ++k) x[k] = wp::sin(x[k]); return x; }",
    "cos": "V cos(V x) { for (int k = 0; k < LANES; ++k) x[k] = wp::cos(x[k]); return x; }",
    "log": "V log(V x) { for (int k = 0; k < LANES; ++k) x[k] = wp::log(x[k]); return x; }",
    "atan2": "V atan2(V y, V x) { for (int k = 0; k < LANES; ++k) x[k] = wp::atan2(y[k], x[k]); return x; }",
    # Cody and Waite's reduction, and the polynomial of Moshier's Cephes: within 2e-7 of e^x.
    "exp": """V exp(V x)
{
    const V lowest = -87.3f, highest = 88.8f;
    const V bounded = __builtin_elementwise_min(__builtin_elementwise_max(x, lowest), highest);
    const V n = __builtin_elementwise_floor(bounded * 1.44269504f + 0.5f);
    const V r = (x - n * 0.693359375f) + n * 2.12194440e-4f;
    V p = r * 1.9875691500e-4f + 1.3981999507e-3f;
    p = p * r + 8.3334519073e-3f;
    p = p * r + 4.1665795894e-2f;
    p = p * r + 1.6666665459e-1f;
    p = p * r + 5.0000001201e-1f;
    p = p * r * r + r + 1.0f;
    const I exponent = (__builtin_convertvector(n, I) + 127) << 23;
    return x < lowest ? V(0.0f) : p * __builtin_bit_cast(V, exponent);
}""",
}


def struct(lanes: int, text: str) -> str:
    """`Lanes`: the words that `text`, the rest of it, uses, and it."""
    used = [word for name, word in _WORDS.items() if re.search(rf"(?<![\w:.]){name}\(", text)]
    body = "".join(re.sub(r"^(?=(?:V|I|void) \w+\()", f"{_INLINE} ", word, flags=re.MULTILINE) + "\n" for word in used)
    return (_TYPES + textwrap.indent(body + text, "    ")).replace("LANES", str(lanes)) + "};\n"


def vector(n: int) -> str:
    """Vectors of `n` numbers, each of which has its lanes."""

    def each(pattern: str, between: str = ", ") -> str:
        return between.join(pattern.replace("#", str(i)) for i in range(n))

    v = f"V{n}"
    members = [f"{v} operator-() const {{ return {{{{{each('-c[#]')}}}}}; }}"]
    members += [f"{v} operator{s}(const {v}& o) const {{ return {{{{{each(f'c[#] {s} o.c[#]')}}}}}; }}" for s in "+-"]
    members += [f"{v} operator{s}(V o) const {{ return {{{{{each(f'c[#] {s} o')}}}}}; }}" for s in "*/"]
    members.append(f"static {v} of(const wp::vec_t<{n}, wp::float32>& p) {{ return {{{{{each('V(p.c[#])')}}}}}; }}")
    functions = [
        f"{v} choose(I mask, const {v}& a, const {v}& b) {{ return {{{{{each('mask ? a.c[#] : b.c[#]')}}}}}; }}",
        f"V dot(const {v}& a, const {v}& b) {{ return {each('a.c[#] * b.c[#]', ' + ')}; }}",
        f"V length(const {v}& a) {{ return sqrt(dot(a, a)); }}",
        f"""{v} normalize(const {v}& a)
{{
    const V l = length(a);
    return choose(l > 0.0f, a / l, {v}{{{{{each("V(0.0f)")}}}}});
}}""",
    ]
    if n == 3:
        crossed = [f"a.c[{i}] * b.c[{j}] - a.c[{j}] * b.c[{i}]" for i, j in ((1, 2), (2, 0), (0, 1))]
        functions.append(f"V3 cross(const V3& a, const V3& b) {{ return {{{{{', '.join(crossed)}}}}}; }}")
    inside = "".join(f"    [[gnu::always_inline]] {member}\n" for member in members)
    return f"struct {v} {{\n    V c[{n}];\n{inside}}};\n" + "".join(f"{_INLINE} {f}\n" for f in functions)


def memory(n: int) -> str:
    """Of vectors of `n` numbers: many places of an array at once."""

    v = f"V{n}"
    element = f"wp::vec_t<{n}, wp::float32>"
    functions = [
        f"""{v} gather(const {element}* a, I at)
{{
    {v} x;
    for (int k = 0; k < LANES; ++k)
        for (int j = 0; j < {n}; ++j)
            x.c[j][k] = a[at[k]].c[j];
    return x;
}}""",
        f"""void store({element}* a, I at, int count, const {v}& x)
{{
    float across[{n}][LANES];
    __builtin_memcpy(across, &x, sizeof(x));
    if (count == LANES)
        for (int k = 0; k < LANES; ++k)
            for (int j = 0; j < {n}; ++j)
                a[at[k]].c[j] = across[j][k];
    else
        for (int k = 0; k < count; ++k)
            for (int j = 0; j < {n}; ++j)
                a[at[k]].c[j] = across[j][k];
}}""",
        f"""void store({element}* a, I at, int count, I mask, const {v}& x)
{{
    for (int k = 0; k < count; ++k)
        if (mask[k])
            for (int j = 0; j < {n}; ++j)
                a[at[k]].c[j] = x.c[j][k];
}}""",
    ]
    return "".join(f"{_INLINE} {f}\n" for f in functions)
