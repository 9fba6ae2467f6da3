/** Classes that have properties of an object in one of their fields. */

// eslint-disable-next-line @typescript-eslint/no-explicit-any -- TypeScript requires it of mixins
type Values = any[];
/** Class whose objects are at least a `T`. */
export type Class<T = object> = abstract new (...values: Values) => T;

/**
 * Return a function that extends a class by properties of the `Part` in its field `field`. read: names of properties that can only
 * be read. write: names of those that can be set as well.
 */
export const propertiesOf =
  <Part extends object>(field: string) =>
  <
    Base extends Class,
    const Read extends readonly (keyof Part)[] = [],
    const Write extends readonly (keyof Part)[] = [],
  >(
    base: Base,
    read: Read,
    write?: Write,
  ): Base & Class<Readonly<Pick<Part, Read[number]>> & Pick<Part, Write[number]>> => {
    type Holder = Record<string, Part>;
    abstract class Extended extends base {}
    const define = (name: keyof Part, more: PropertyDescriptor): unknown =>
      Object.defineProperty(Extended.prototype, name, {
        ...more,
        configurable: true,
        get(this: Holder) {
          return this[field][name];
        },
      });
    for (const name of read) define(name, {});
    for (const name of write ?? [])
      define(name, {
        set(this: Holder, value: Part[typeof name]) {
          this[field][name] = value;
        },
      });
    return Extended as never;
  };
