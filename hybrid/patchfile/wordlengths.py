"""The keys `word` and `words` of the digital machine: its word length, and that of single words."""

from __future__ import annotations

from collections.abc import Mapping

from hybrid.errors import PatchError, did_you_mean, quoted
from hybrid.fields import Fields, in_words, only_keys, table_of
from hybrid.language import OVERFLOWS, ROUNDINGS, WORD_KEYS, WORD_LENGTHS
from hybrid.patch import WordSettings
from hybrid.patchfile.book import Book
from hybrid.units import PURE, Dimension
from hybrid.wordlength import SINGLE_BITS, Kind, Overflow
from hybrid.yamltree import Table, Text, Tree

SHORT: Mapping[str, WordSettings] = {
    "float64": WordSettings(),
    "float32": WordSettings(Kind.SINGLE, SINGLE_BITS),
}


def read_word_length(book: Book, digital: Table) -> WordSettings:
    """The word length of the program."""
    tree = digital.entries.get("word")
    return _settings(book, tree, "word of digital", PURE) if tree else WordSettings()


def read_word_lengths(
    book: Book, digital: Table, dimensions: Mapping[str, Dimension | None], words: frozenset[str]
) -> dict[str, WordSettings]:
    """Those of single words and states, sorted."""
    tree = digital.entries.get("words")
    if tree is None:
        return {}
    table, found = table_of(tree, "words", "word: word length"), {}
    for word, item, place in table:
        if word not in words:
            hint = did_you_mean(word, words)
            raise PatchError(f"words: no word or state {quoted(word)}; {hint}", place)
        found[word] = _settings(book, item, f"word length of {word!r}", dimensions[word])
    return dict(sorted(found.items()))


def _settings(book: Book, tree: Tree, what: str, due: Dimension | None) -> WordSettings:
    if isinstance(tree, Text):
        if tree.text not in SHORT:
            raise PatchError(f"{what} is {quoted(tree.text)}; valid: {WORD_LENGTHS}", tree.place)
        return SHORT[tree.text]
    table = table_of(tree, what, "mantissa: bits, or fixed: bits")
    fields = Fields(table, what, WORD_KEYS, book.scope, table.place)
    kinds = [key for key in ("mantissa", "fixed") if key in table.entries]
    if len(kinds) != 1:
        raise PatchError(
            f"{what} needs either mantissa or fixed; valid: {WORD_LENGTHS}", table.place
        )
    cuts = _choice(fields, "rounding", ROUNDINGS) == "truncate"
    if kinds == ["mantissa"]:
        only_keys(table, [k for k in WORD_KEYS if k.name in ("mantissa", "rounding")], what)
        return WordSettings(Kind.BITS, fields.integer("mantissa", 0), cuts, place=tree.place)
    full_scale = fields.quantities(WORD_KEYS).get("full_scale")
    if full_scale is not None:
        _, dimension = fields.value_of(fields.tree("full_scale"), f"full_scale of {what}")
        if due is not None and dimension not in (None, PURE, due):
            raise PatchError(
                f"full_scale of {what} is {in_words(dimension or PURE)}; it must be {in_words(due)}",
                full_scale.place,
            )
    overflow = Overflow[_choice(fields, "overflow", OVERFLOWS).upper()]
    return WordSettings(
        Kind.FIXED, fields.integer("fixed", 0), cuts, full_scale, overflow, tree.place
    )


def _choice(fields: Fields, key: str, valid: tuple[str, ...]) -> str:
    """One of the words valid for a key, the first where it is not given."""
    text = fields.text(key, valid[0])
    if text not in valid:
        raise PatchError(
            f"{fields.what}: {key} is {quoted(text)}; valid: {', '.join(valid)}", fields.place(key)
        )
    return text
