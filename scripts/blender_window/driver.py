"""Runs inside Blender: takes pieces of Python from a folder, runs each in a timer, leaves its value or its traceback.

Usage: blender … --python driver.py -- FOLDER
Request N is ``N.json``; its answer is ``N.answer.json``. A piece's value is that of its last expression; a generator is
taken a step a tick, so that Blender handles events and draws in between, and its value is what it returns.
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
# What a piece finds, and leaves to the next one.
names = runpy.run_path(os.path.join(os.path.dirname(os.path.abspath(__file__)), "inside.py"))
state = {"next": 0, "generator": None}


def run(code):
    """Run a piece of Python; return the value of its last expression, None where it ends in a statement."""
    tree = ast.parse(code)
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, "<window>", "exec"), names)
    return eval(compile(ast.Expression(last.value), "<window>", "eval"), names) if last else None


def plain(value):
    """Return a value of Blender or numpy as something that JSON can hold."""
    if hasattr(value, "tolist"):
        return value.tolist()
    return sorted(value) if isinstance(value, (set, frozenset)) else list(value)


def answer(said):
    """Leave an answer; look for the next request from now on."""
    path = os.path.join(FOLDER, f"{state['next']}.answer.json")
    with open(path + ".part", "w", encoding="utf-8") as file:
        file.write(said)
    os.replace(path + ".part", path)
    state.update(next=state["next"] + 1, generator=None)


def take(request):
    """Run a request, or go on with the generator that the last one left; answer when there is something to say."""
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
        said = json.dumps({"value": value}, default=plain)
    except BaseException:  # noqa: BLE001 whoever asked is told
        said = json.dumps({"error": traceback.format_exc()})
    answer(said)


def tick():
    """Do what there is to do."""
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
