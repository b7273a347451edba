"""Runs inside Blender: executes Python code from a folder in a timer, and writes its value or traceback.

Usage: blender … --python driver.py -- FOLDER
Request N is ``N.json``; its answer is ``N.answer.json``. The value is that of the last expression. A generator advances
a step a tick, so that Blender handles events and draws in between; its value is its return value.
"""

import ast
import json
import os
import runpy
import sys
import traceback
from contextlib import nullcontext
from inspect import isgenerator

import bpy

FOLDER = sys.argv[sys.argv.index("--") + 1]
TICK = 0.02  # seconds
# Globals of all requests.
names = runpy.run_path(os.path.join(os.path.dirname(os.path.abspath(__file__)), "inside.py"))
state = {"next": 0, "generator": None}


def run(code):
    """Run Python code; return the value of its last expression, None if it ends in a statement."""
    tree = ast.parse(code)
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, "<window>", "exec"), names)
    return eval(compile(ast.Expression(last.value), "<window>", "eval"), names) if last else None


def plain(value):
    """Return a value of Blender or numpy as a type that JSON has."""
    if hasattr(value, "tolist"):
        return value.tolist()
    return sorted(value) if isinstance(value, (set, frozenset)) else list(value)


def answer(text):
    """Write the answer and go on to the next request."""
    path = os.path.join(FOLDER, f"{state['next']}.answer.json")
    with open(path + ".part", "w", encoding="utf-8") as file:
        file.write(text)
    os.replace(path + ".part", path)
    state.update(next=state["next"] + 1, generator=None)


def take(request):
    """Run a request, or advance the generator of the last one; answer when there is a value or an error."""
    generator = state["generator"]
    try:
        if generator is None:
            with override(request["area"]) if request["area"] else nullcontext():
                value = run(request["code"])
            if isgenerator(value):
                state["generator"] = value
                return
        else:
            try:
                next(generator)
                return
            except StopIteration as end:
                value = end.value
        text = json.dumps({"value": value}, default=plain)
    except BaseException:  # noqa: BLE001 the answer has the traceback
        text = json.dumps({"error": traceback.format_exc()})
    answer(text)


def tick():
    """Advance the generator, or run the next request if there is one."""
    path = os.path.join(FOLDER, f"{state['next']}.json")
    if state["generator"] is not None:
        take(None)
    elif os.path.exists(path):
        with open(path, encoding="utf-8") as file:
            take(json.load(file))
    return TICK


override = names["override"]
bpy.context.preferences.view.show_splash = False
bpy.app.timers.register(tick, persistent=True)
