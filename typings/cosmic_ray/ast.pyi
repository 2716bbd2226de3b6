from collections.abc import Iterator

class Node:
    type: str
    children: list[Node]
    start_pos: tuple[int, int]
    end_pos: tuple[int, int]
    def get_code(self, include_prefix: bool = True) -> str: ...
    def get_first_leaf(self) -> Leaf: ...

class Leaf(Node):
    prefix: str

def get_ast(source: str) -> Node: ...
def ast_nodes(node: Node) -> Iterator[Node]: ...
