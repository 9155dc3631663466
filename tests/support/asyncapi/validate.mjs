// Prints the problems that AsyncAPI's parser has with a document, as JSON: node validate.mjs FILE
import { readFileSync } from "node:fs";
import { Parser } from "@asyncapi/parser";

console.log(JSON.stringify(await new Parser().validate(readFileSync(process.argv[2], "utf8"))));
