"""Programs of Python 2 do what they did. The values are those that Python 2.7 prints."""

from __future__ import annotations

import io
from contextlib import redirect_stdout
from typing import Any

import pytest
from rospy_stand_in.python2 import MODULES, NAMES, compiled, is_python2, rewritten


def printed(source: str, **names: Any) -> str:
    out = io.StringIO()
    with redirect_stdout(out):
        exec(compiled(source, "program", is_old=True), {**NAMES, "out": out, **names})
    return out.getvalue()


OWN = """
class A:
  def next(self): return 6
  def keys(self): return 7
print A().next(), A().keys()
"""


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ('print "a"', "a\n"),
        ('print "a", 1, "b"', "a 1 b\n"),
        ('print "a",\nprint "b"', "a b\n"),
        ("print", "\n"),
        ("print ()", "()\n"),
        ('print "%d of %d" % (1, 2)', "1 of 2\n"),
        ('print("a")', "a\n"),
        ('print ("a"), "b"', "a b\n"),
        ('print >>out, "a", 2', "a 2\n"),
        ('print "a"; print "b" # c', "a\nb\n"),
        ('if 1: print "a"\nelse: print "b"', "a\n"),
        ('for i in xrange(2): print i,', "0 1 "),
        ('print "print \\"x\\"" # print "y"', 'print "x"\n'),
        ('print """a\nprint "b"\n"""', 'a\nprint "b"\n\n'),
        ("print 7 / 2, -7 / 2, 7 / 2.0, 1 // 2", "3 -4 3.5 0\n"),
        ("x = 7\nx /= 2\nprint x", "3\n"),
        ("d = {'a': [9]}\nd['a'][0] /= 2\nprint d['a'][0]", "4\n"),
        ("from __future__ import division\nprint 7 / 2", "3.5\n"),
        ("print 0777, 10L, 0xFFL, 0", "511 10 255 0\n"),
        ("print 1 <> 2", "True\n"),
        ("print `1 + 1` + 'a'", "2a\n"),
        ("print ur'a' + u'b'", "ab\n"),
        ("print map(str, [1, 2]), filter(None, [0, 1]), zip([1], [2])",
         "['1', '2'] [1] [(1, 2)]\n"),
        ("print range(3)[::-1] + [9]", "[2, 1, 0, 9]\n"),
        ("d = {'a': 1}\nprint d.keys()[0], d.has_key('a'), d.values() + d.items()",
         "a True [1, ('a', 1)]\n"),
        ("for k, v in {'a': 1}.iteritems(): print k, v", "a 1\n"),
        ("print iter([5]).next()", "5\n"),
        (OWN, "6 7\n"),
        ("try:\n    raise ValueError, 'why'\nexcept ValueError, e:\n    print e", "why\n"),
        ("try:\n    1/0\nexcept (ValueError, ZeroDivisionError), e: print 'zero'", "zero\n"),
        ("exec 'x = 4'\nprint x", "4\n"),
        ("print reduce(lambda a, b: a + b, [1, 2, 3])", "6\n"),
        ("print isinstance('a', basestring), unicode(3), long(4), cmp(1, 2)", "True 3 4 -1\n"),
        ("if True:\n\tprint 'tab'\n        print 'eight spaces'", "tab\neight spaces\n"),
        ("if True:\n    if True:\n\tprint 'a tab is as deep as eight spaces'",
         "a tab is as deep as eight spaces\n"),
        ("x = [1,\n2]\nprint x, \\\n  3", "[1, 2] 3\n"),
        ("f = lambda: 1\nif f() and (lambda: 1)(): print 'yes'", "yes\n"),
        ("a = {'b': 1}\nprint a['b']\nprint a", "1\n{'b': 1}\n"),
        ("s = 'é'\r\nprint len(s)\r\n", "1\n"),
    ],
)  # fmt: skip
def test_what_it_did_it_does(source: str, expected: str) -> None:
    assert printed(source) == expected


@pytest.mark.parametrize(
    ("source", "is_old"),
    [
        ("print('a')", False),
        ("x = 1 / 2", False),
        ("#!/usr/bin/env python3\nprint('a')", False),
        ("#!/usr/bin/env python\nprint('a')", False),
        ("#!/usr/bin/env python2.7\nprint('a')", True),
        ("print 'a'", True),
        ("for i in xrange(3): pass", True),
        ("# xrange(3)\nprint('a')", False),
        ("import Queue", True),
        ("d.iteritems()", True),
    ],
)
def test_which_python_a_program_is_of(source: str, is_old: bool) -> None:
    assert is_python2(source) is is_old


def test_a_program_of_python_3_is_not_touched() -> None:
    names: dict[str, Any] = {}
    exec(compiled("x = 7 / 2\ny = (1).__class__", "program", is_old=False), names)
    assert names["x"] == 3.5


@pytest.mark.parametrize("source", ["print 'a", "x = = 1", "def f(:", "print >>"])
def test_what_is_neither_is_a_syntax_error(source: str) -> None:
    with pytest.raises(SyntaxError):
        compiled(source, "program", is_old=True)


def test_lines_keep_their_numbers() -> None:
    """Or a traceback would name others."""
    source = "a = 1\n\nprint \\\n  a\n'''\n\n'''\nraise ValueError, 'x'\n"
    assert rewritten(source).count("\n") == source.count("\n")
    with pytest.raises(ValueError, match="x") as caught:
        printed(source)
    assert caught.traceback[-1].lineno == 7


def test_a_typed_value_is_no_program(monkeypatch: pytest.MonkeyPatch) -> None:
    """Python 2 evaluates what is typed at ``input``."""
    typed = iter(["3", "[1, 2]", "__import__('os')", "left"])
    monkeypatch.setattr("builtins.input", lambda _: next(typed))
    assert [NAMES["input"]() for _ in range(4)] == [3, [1, 2], "__import__('os')", "left"]


def test_the_modules_of_python_2_are_there() -> None:
    assert MODULES["Queue"] == "queue"
    assert MODULES["ConfigParser"] == "configparser"
