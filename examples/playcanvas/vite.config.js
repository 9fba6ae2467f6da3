export default { base: "./" }; // the built page works in any folder of a web host
